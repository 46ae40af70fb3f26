"""``lerobot-buds-diagnose``: tells which link of a policy is weak, on recorded demonstrations."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_buds.core import ConfigError, write_json

from .datasets import DatasetOptions
from .running import parse, run


@dataclass
class DiagnoseConfig(DatasetOptions):
    """Settings of a diagnosis; `episodes` are best those that the policy was not trained on."""

    policy_path: str = ""
    """The checkpoint: its folder (``.../pretrained_model``) or its repository on the Hub."""

    output: Path | None = None
    """Writes all figures there, as JSON."""

    device: str | None = None
    """Where to compute; None for what the checkpoint says."""

    seed: int = 0
    """Seed of the subgoals that are dealt out to other frames."""


def diagnose_policy(config: DiagnoseConfig) -> dict[str, Any]:
    """Runs the diagnosis, see `evaluation.diagnosis.diagnose`.

    Raises:
        ConfigError: No checkpoint is named.
        CheckpointError: The checkpoint cannot be had, or does not fit the dataset.
        DatasetError: The dataset is damaged or incomplete.
        SegmentationError: It is not segmented.
    """
    from lerobot_buds.evaluation.checkpoint import load_policy
    from lerobot_buds.evaluation.diagnosis import diagnose
    from lerobot_buds.evaluation.recorded import RecordedFrames

    if not config.policy_path:
        raise ConfigError("policy_path is missing: which checkpoint is to be diagnosed?")
    dataset = config.open()
    policy = load_policy(config.policy_path, dataset.root, config.device)
    frames = RecordedFrames(dataset, policy)
    figures = diagnose(policy, frames, np.arange(len(frames.starts)), config.seed)
    if config.output is not None:
        write_json(config.output, figures)
    return figures


def table(figures: dict[str, Any]) -> str:
    """Formats a diagnosis: who decides, against how near to a boundary; then skills and subgoals."""
    columns = {"all frames": figures["errors"], **{f"< {name}": near for name, near in figures.get("near", {}).items()}}
    lines = ["squared action error " + "".join(f"{name:>12}" for name in columns)]
    for who in figures["errors"]:
        values = ["-" if column[who] is None else f"{column[who]:.4f}" for column in columns.values()]
        lines.append(f"  {who:<19}" + "".join(f"{value:>12}" for value in values))
    if "skill_ids" in figures:
        ids, subgoals = figures["skill_ids"], figures["subgoals"]
        lines += [
            f"right skills         {ids['right']:.1%} of the frames, near boundaries {ids['right_near'] or 0:.1%}",
            f"switches             {ids['switches']:.1f} an episode; demonstrated {ids['switches_demonstrated']:.1f}",
            f"imagined subgoals    error {subgoals['imagined_error']:.3f}; spread within skills "
            f"{subgoals['spread_within']:.3f}",
        ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Entry point of the console script."""
    config = parse(DiagnoseConfig)
    print(table(run(lambda: diagnose_policy(config))), end="")
