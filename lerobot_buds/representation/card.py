"""The card of a representation, as the Hub shows it."""

from pathlib import Path
from typing import Any

from huggingface_hub import ModelCard, ModelCardData

from lerobot_buds.core import write_atomically

from .reports import kept_report

CARD_FILE = "README.md"


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
    config, modalities = record["config"], record["modalities"]
    kind = "A variational auto-encoder trained on demonstrations"
    if config["backbone"]:
        weights = Path(config["backbone_weights"]).name  # of a file, no more than its name leaves this machine
        kind = f"Frozen features of `{config['backbone']}` (weights: {weights}), reduced and scaled"
    state = [modalities["state_names"][dim] for dim in modalities["state_dims"]]
    rows = [f"| {name} | {height} x {width} pixels |" for name, (height, width) in modalities["cameras"].items()]
    rows += [f"| observation.state | {', '.join(state)} |"] * bool(state)
    return "\n".join(
        [
            "# A representation of demonstrations",
            "",
            f"{kind}, for skill discovery with BUDS (Zhu, Stone, Zhu, RA-L 2022). It maps what the robot sees and",
            "feels in one frame to one vector.",
            "",
            "| fused | what |",
            "|---|---|",
            *rows,
            "",
            *_losses(record["losses"]),
            "```",
            f"lerobot-buds-segment --representation_path={repo_id} --repo_id=...",
            "```",
            "",
        ]
    )


def _losses(losses: list[dict[str, float]]) -> list[str]:
    if not losses:
        return []
    kept = losses[kept_report(losses)]
    names = [name.removeprefix("training/") for name in kept if name.startswith("training/")]
    rows = [
        f"| {name} | {kept[f'training/{name}']:.3g} | {kept.get(f'validation/{name}', float('nan')):.3g} |"
        for name in names
    ]
    head = f"Kept at step {kept['step']} of {losses[-1]['step']}. Errors are squared and summed over a frame."
    return [head, "", "| loss | training, last batch | held-out episodes |", "|---|---|---|", *rows, ""]
