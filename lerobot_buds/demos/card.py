"""The card of a recorded dataset: what it holds and where it comes from, as the Hub shows it."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from huggingface_hub import DatasetCard, DatasetCardData
from numpy.typing import NDArray

from lerobot_buds.core import CONTACT_SHEET_FILE, write_atomically
from lerobot_buds.envs import FPS

CARD_FILE = "README.md"


def write_card(folder: Path, record: dict[str, Any], lengths: Sequence[int]) -> None:
    """Writes the card into a dataset, with the contact sheet that is there.

    Args:
        folder: The dataset.
        record: Its record of how it was collected.
        lengths: Frames of each episode, one task after the other.
    """
    data = DatasetCardData(
        license="apache-2.0",
        task_categories=["robotics"],
        tags=["LeRobot", "robosuite", "buds"],
        configs=[{"config_name": "default", "data_files": "data/*/*.parquet"}],  # as LeRobot's own card has it
    )
    card = DatasetCard(f"---\n{data.to_yaml()}\n---\n\n{_body(record, lengths)}")
    write_atomically(folder / CARD_FILE, card.save)


def _body(record: dict[str, Any], lengths: Sequence[int]) -> str:
    ends = np.cumsum([len(task["episode_seeds"]) for task in record["tasks"]]).tolist()
    rows = [
        _row(task, np.array(lengths[end - len(task["episode_seeds"]) : end]))
        for task, end in zip(record["tasks"], ends, strict=True)
    ]
    versions = ", ".join(f"{name} {version}" for name, version in sorted(record["versions"].items()))
    return "\n".join(
        [
            "# Scripted demonstrations",
            "",
            "A LeRobotDataset of robosuite tasks, recorded by `lerobot-buds-collect`. The demonstrator is a script",
            f"with human-like variety, not a person. {len(lengths)} episodes, {sum(lengths)} frames at {FPS} Hz,",
            f"cameras of {record['image_size']} pixels drawn with the profile `{record['render_profile']}`.",
            "",
            *_manner(record),
            *_actions(record),
            "| task | instruction | episodes | failed attempts | frames an episode: mean (range) | seeds |",
            "|---|---|---|---|---|---|",
            *rows,
            "",
            f"The column `true_stage` counts these stages: {', '.join(record['stages'])}.",
            "",
            f"![Both cameras over one demonstration, by stage]({CONTACT_SHEET_FILE})",
            "",
            f"Made with {versions}.",
            "",
        ]
    )


def _manner(record: dict[str, Any]) -> list[str]:
    """Says what the manner `people` comes to; nothing where the demonstrator is the plain script."""
    if record["manner"] == "scripted":
        return []
    stages = Counter(stage for task in record["tasks"] for episode in task["retries"] for stage in episode)
    again = ", ".join(f"{stage} {count}" for stage, count in sorted(stages.items())) or "nothing"
    return [
        f"Manner `{record['manner']}`: the script waits, overshoots, misses, sees that and tries again, as people do.",
        f"Missed and done again, by stage: {again}.",
        "",
    ]


def _actions(record: dict[str, Any]) -> list[str]:
    """Says where actions are not what was executed."""
    if not record["clean_actions"]:
        return []
    return [
        "Actions are what the script meant (`--clean_actions`). A tremor was executed on top of them, so that",
        "executing them again does not repeat an episode.",
        "",
    ]


def _row(task: dict[str, Any], lengths: NDArray[np.int64]) -> str:
    seeds, failed = task["episode_seeds"], len(task["failed_attempts"])
    spread = f"{lengths.mean():.0f} ({lengths.min()} to {lengths.max()})"
    return (
        f"| {task['name']} | {task['description']} | {len(lengths)} | {failed} | {spread} | {seeds[0]} to {seeds[-1]} |"
    )
