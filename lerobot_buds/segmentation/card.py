"""The card of a segmented dataset, as the Hub shows it: made of its record and its names, so that it is never lost."""

import json
import shlex
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_buds.core import CARD_FILE, EXEMPLARS_FILE, RECORD_DIR, TIMELINE_FILE, sha256_of_json, write_atomically

from .naming import names_of
from .record import SegmentationRecord
from .settings import DiscoveryConfig
from .timeline import draw_timeline

SPARE_CARD_FILE = f"{RECORD_DIR}/card.md"
"""The same text where no other program looks: LeRobot's own `push_to_hub` puts a card of its own over `CARD_FILE`."""

_CITATION = """@article{zhu2022bottom,
  title = {Bottom-Up Skill Discovery from Unsegmented Demonstrations for Long-Horizon Robot Manipulation},
  author = {Zhu, Yifeng and Stone, Peter and Zhu, Yuke},
  journal = {IEEE Robotics and Automation Letters},
  year = {2022}
}"""
_UNKNOWN = "not known"


def card_kwargs(root: Path | str, repo_id: str) -> dict[str, Any]:
    """Puts what is known of a segmented dataset into LeRobot's card.

    Args:
        root: Folder of the dataset.
        repo_id: Where it is going.

    Returns:
        Arguments for ``LeRobotDataset.push_to_hub``.

    Raises:
        SegmentationError: The dataset is not segmented.
    """
    return {
        "tags": ["buds", "skill-discovery"],
        "license": None,  # the recordings are whose they were
        "dataset_description": _body(Path(root), repo_id, TIMELINE_FILE),
        "citation_bibtex": _CITATION,
    }


def write_card(root: Path, repo_id: str, labels_only: bool = False) -> None:
    """Draws the timeline of a segmented dataset, and writes its card.

    Args:
        root: Folder of the dataset.
        repo_id: Its name.
        labels_only: It is a companion, without recordings.

    Raises:
        SegmentationError: The dataset is not segmented.
        StorageError: It cannot be written.
    """
    from huggingface_hub import DatasetCard, DatasetCardData

    record = SegmentationRecord.read(root)
    title = f"{record.source.repo_id}: {record.n_skills} skills in {len(record.episodes)} demonstrations"
    names = names_of(root, record.n_skills)
    draw_timeline(root / TIMELINE_FILE, record.labels, record.source.fps, title=title, names=names)
    files = "labels/*.parquet" if labels_only else "data/*/*.parquet"  # the second as in LeRobot's own card
    data = DatasetCardData(
        task_categories=["robotics"],
        tags=[*([] if labels_only else ["LeRobot"]), "buds", "skill-discovery"],
        configs=[{"config_name": "default", "data_files": files}],
    )
    card = DatasetCard(f"---\n{data.to_yaml()}\n---\n\n{_body(root, repo_id, TIMELINE_FILE, labels_only)}")
    write_atomically(root / CARD_FILE, card.save)
    spare = _body(root, repo_id, Path(TIMELINE_FILE).name, labels_only)
    write_atomically(root / SPARE_CARD_FILE, lambda part: part.write_text(spare, encoding="utf-8"))


def _body(root: Path, repo_id: str, picture: str, labels_only: bool = False) -> str:
    from lerobot_buds.data import render_card

    record = SegmentationRecord.read(root)
    names = names_of(root, record.n_skills) or [f"skill {number}" for number in range(record.n_skills)]
    seconds = np.array(record.source.episode_lengths) / record.source.fps
    return render_card(
        "dataset",
        repo_id=repo_id,
        labels_only=labels_only,
        can_label=(root / EXEMPLARS_FILE).exists(),
        source=record.source,
        n_skills=record.n_skills,
        episodes=len(record.episodes),
        frames=record.source.total_frames,
        how=_how(record),
        picture=picture if (root / TIMELINE_FILE).exists() else None,
        skills=[{**skill, "name": name} for skill, name in zip(record.skills, names, strict=True)],
        lengths=f"{seconds.mean():.1f} s on average, {seconds.min():.1f} to {seconds.max():.1f} s",
        horizon_s=record.horizon / record.source.fps,
        stability=_UNKNOWN if record.stability is None else f"{record.stability:.2f}",
        agreement=record.agreement or {},
        parents=_parents(record),
        labels_hash=record.labels_hash,
        package_version=record.package_version,
        rebuild=rebuild_command(record),
    )


def _how(record: SegmentationRecord) -> str:
    if record.labels_from is not None:
        return f"read from {record.labels_from}"
    return "discovered by BUDS" if record.library is None else "taken over from other demonstrations"


def _parents(record: SegmentationRecord) -> list[dict[str, str]]:
    """Lists what the labels were made from: demonstrations, representation, and skills that were taken over."""
    from lerobot_buds.data import shown_name

    source, network, library = record.source, record.representation, record.library or {}
    (lineage,) = library.get("lineage", ())[:1] or (None,)
    content = sha256_of_json(source.content) if source.content else None
    found = [
        ("demonstrations", source.repo_id, source.commit, content),
        ("representation", network.get("repo_id"), network.get("commit"), network.get("hash")),
        ("skills", shown_name(library.get("name", "")), library.get("commit"), lineage),
    ]
    return [
        {"kind": kind, "repo_id": name or f"in {RECORD_DIR}", "commit": commit or _UNKNOWN, "hash": digest or _UNKNOWN}
        for kind, name, commit, digest in found[: 3 if library else 2]
    ]


def rebuild_command(record: SegmentationRecord) -> str:
    """Writes the command that makes these labels again: every setting that is not the default.

    Args:
        record: The segmentation.
    """
    from lerobot_buds.data import shown_name

    source, options = record.source, {"repo_id": record.source.repo_id}
    if source.commit is not None:
        options["revision"] = source.commit
    if source.chosen is not None:
        options["episodes"] = json.dumps(list(source.chosen))
    options["subgoal_horizon_s"] = f"{record.horizon / source.fps:g}"
    if record.library is not None:
        options |= {"library": shown_name(record.library["name"]), "grow": json.dumps(record.library["grown"])}
    else:
        if record.labels_from is None:
            options |= _changed("discovery", record.parameters, DiscoveryConfig())
        else:
            options["labels_from"] = record.labels_from
        options |= _representation_options(record.representation)
    return shlex.join(["lerobot-buds-segment", *(f"--{name}={value}" for name, value in options.items())])


def _representation_options(description: Mapping[str, Any]) -> dict[str, str]:
    from lerobot_buds.representation import RepresentationConfig

    if description.get("repo_id") is not None:
        return {"representation_path": description["repo_id"]}
    return _changed("representation", description, RepresentationConfig())


def _changed(name: str, values: Mapping[str, Any], defaults: Any) -> dict[str, str]:
    from lerobot_buds.data import shown_name

    known = asdict(defaults)
    changed = {key: value for key, value in values.items() if key in known and known[key] != value}
    return {f"{name}.{key}": shown_name(v) if isinstance(v, str) else json.dumps(v) for key, v in changed.items()}
