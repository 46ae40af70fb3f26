"""The card of a representation, as the Hub shows it."""

from pathlib import Path
from typing import Any

from huggingface_hub import ModelCard, ModelCardData

from lerobot_buds.core import write_atomically
from lerobot_buds.data import render_card

from .reports import kept_report


def write_card(path: Path, record: dict[str, Any], repo_id: str) -> None:
    """Writes the card.

    Args:
        path: The file.
        record: What ``representation.json`` holds.
        repo_id: Where the representation is going.
    """
    data = ModelCardData(
        license="apache-2.0", library_name="lerobot", pipeline_tag="robotics", tags=["lerobot", "robotics", "buds"]
    )
    card = ModelCard(f"---\n{data.to_yaml()}\n---\n\n{_body(record, repo_id)}")
    write_atomically(path, card.save)


def _body(record: dict[str, Any], repo_id: str) -> str:
    config, modalities, losses = record["config"], record["modalities"], record["losses"]
    kept = losses[kept_report(losses)] if losses else {}
    return render_card(
        "representation",
        backbone=config["backbone"],
        weights=Path(config["backbone_weights"] or "").name,  # of a file, no more than its name leaves this machine
        cameras=[(name, *size) for name, size in modalities["cameras"].items()],
        state=[modalities["state_names"][dim] for dim in modalities["state_dims"]],
        parent=record["trained_on"],
        kept=kept.get("step"),
        last=losses[-1]["step"] if losses else None,
        losses=[
            (name.removeprefix("training/"), value, kept.get(name.replace("training", "validation"), float("nan")))
            for name, value in kept.items()
            if name.startswith("training/")
        ],
        repo_id=repo_id,
    )
