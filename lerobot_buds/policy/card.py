"""The card of a checkpoint, as the Hub shows it."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from huggingface_hub import ModelCard, ModelCardData

from lerobot_buds.core import CARD_FILE, DISTRIBUTION, write_atomically
from lerobot_buds.data import render_card

from .configuration_buds import BudsConfig

_UNKNOWN = "not known"
_KINDS = {"single": "whole demonstrations", "flat": "behaviour cloning, without subgoals", "segments": "as labelled"}


def card_text(
    config: BudsConfig,
    repo_id: str | None = None,
    diagnosis: Mapping[str, Any] | None = None,
    rollouts: Mapping[str, Any] | None = None,
    ribbons: str | None = None,
) -> str:
    """Describes a policy in Markdown.

    Args:
        config: A configuration that is completed.
        repo_id: Where the policy is going, where that is known.
        diagnosis: What ``lerobot-buds-diagnose`` found.
        rollouts: ``task``, and ``figures`` as pairs of name and value.
        ribbons: Path of their picture in the repository.
    """
    return render_card(
        "policy",
        n_skills=config.n_skills or 1,
        kind=_KINDS[config.skills],
        package_version=version(DISTRIBUTION),
        tasks=config.tasks,
        cameras=list(config.image_features),
        fps=config.fps or 0.0,
        period_s=config.meta_period_s,
        parents=_parents(config),
        repo_id=repo_id or config.repo_id or "...",
        diagnosis=diagnosis,
        rollouts=rollouts,
        ribbons=ribbons,
    )


def write_card(folder: Path, text: str, license: str | None = None, tags: Sequence[str] = ()) -> None:
    """Writes the card into a checkpoint.

    Args:
        folder: The checkpoint.
        text: What `card_text` says.
        license: License of the weights.
        tags: More tags.

    Raises:
        StorageError: It cannot be written.
    """
    data = ModelCardData(
        license=license or "apache-2.0",  # as LeRobot's own card has it
        library_name="lerobot",
        pipeline_tag="robotics",
        tags=sorted({"buds", "lerobot", "robotics", *tags}),
    )
    write_atomically(folder / CARD_FILE, ModelCard(f"---\n{data.to_yaml()}\n---\n\n{text}").save)


def _parents(config: BudsConfig) -> list[dict[str, str]]:
    dataset, skills = config.parents.get("dataset", {}), config.parents.get("skills", {})
    found = [("demonstrations", dataset, dataset.get("content"))]
    if config.segmentation is not None:
        found.append(("labels", dataset, config.segmentation))
    if config.representation is not None:
        found.append(("representation", dataset, config.representation))
    if skills:
        found.append(("skills", skills, skills.get("sha256")))
    return [
        {
            "kind": kind,
            "repo_id": parent.get("repo_id", _UNKNOWN),
            "commit": parent.get("commit", _UNKNOWN),
            "hash": digest or _UNKNOWN,
        }
        for kind, parent, digest in found
    ]
