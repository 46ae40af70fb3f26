"""``lerobot-buds-compare``: compares segmentation methods on a dataset whose true stages are known."""

import logging
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lerobot_buds.core import (
    ACTION,
    OUR_STATE,
    STATE,
    SUBTASKS,
    TRUE_STAGE,
    ConfigError,
    DatasetError,
    FloatArray,
    dims_used,
    near_names,
    remove_leftovers,
    write_json,
)
from lerobot_buds.representation import RepresentationConfig
from lerobot_buds.segmentation import DiscoveryConfig

from .datasets import DatasetOptions
from .running import parse, run

if TYPE_CHECKING:
    from lerobot_buds.data import LocalDataset
    from lerobot_buds.evaluation import Result

logger = logging.getLogger(__name__)

OURS = {"position": ("eef*",), "gripper": ("gripper*",)}
"""Where the state of our own environments holds the hand's position, and the gripper's fingers."""

GRIP_AND_REST = "grip and rest"


@dataclass
class CompareConfig(DatasetOptions):
    """Settings of a comparison; the dataset needs labels to score against."""

    work_dir: Path | None = None
    """Keeps the representations and the results; None for ``outputs/compare/`` and the dataset's name."""

    truth: str = TRUE_STAGE
    """What is scored against: a column such as ``true_stage``, which scripted demonstrations have, or the ``subtasks``
    that people or lerobot-annotate wrote."""

    seeds: int = 3
    """Number of seeds, from 0: each trains its own representation and clusters with it."""

    methods: list[str] | None = None
    """Methods to compare; all that the dataset allows where None."""

    position: list[str] | None = None
    """Shell-style patterns of the ``observation.state`` names that are the hand's position; None where nobody knows
    them, but for our own environments. `GRIP_AND_REST` needs them."""

    gripper: list[str] | None = None
    """The same of the gripper's fingers, whose mean size is its opening."""

    representation: RepresentationConfig = field(default_factory=RepresentationConfig)
    """Settings of the representation, but for its seed."""

    discovery: DiscoveryConfig = field(default_factory=DiscoveryConfig)
    """Settings of skill discovery, but for its seed."""


def run_comparison(config: CompareConfig, work_dir: Path) -> "list[Result]":
    """Trains what is missing, compares all methods on all seeds and leaves the results in the working folder.

    Raises:
        ConfigError: A setting cannot work, or ruptures is missing.
        DatasetError: The dataset is damaged or incomplete, its truth is not known, or another process is at the
            same work.
        SegmentationError: It cannot be segmented as asked.
    """
    from lerobot_buds.data import Origin, check_demonstrations, dimension_names, given_labels, only_writer
    from lerobot_buds.evaluation import Demonstrations, compare, comparison_rows, draw_comparison
    from lerobot_buds.representation import encode_dataset, train_representation

    if config.seeds < 1:
        raise ConfigError(f"seeds={config.seeds} cannot work; it must be at least 1.")
    dataset = config.open()
    if config.truth not in (SUBTASKS, *dataset.features):
        raise DatasetError(
            f"{dataset.root} has no column {config.truth!r}: no segmentation can be scored. "
            f"{near_names(config.truth, [SUBTASKS, *dataset.features])}"
        )
    stages, fps = given_labels(dataset, config.truth).labels, dataset.fps
    dataset.require([STATE, ACTION])
    position, fingers = (_signal(dataset, getattr(config, name), name) for name in OURS)
    gripper = [np.abs(opening).sum(axis=1) / max(1, opening.shape[1]) for opening in fingers]
    are_ours = tuple(dimension_names(dataset.features[STATE])) == OUR_STATE
    methods = _methods(config, are_ours or (config.position is not None and config.gripper is not None))
    check_demonstrations(dataset, config.representation.cameras, side=config.representation.side)
    results: list[Result] = []
    with only_writer(work_dir):
        for seed in range(config.seeds):
            settings, folder = replace(config.representation, seed=seed), work_dir / f"representation_{seed}"
            remove_leftovers(folder)
            representation = train_representation(dataset, settings, folder)
            latents = encode_dataset(dataset, representation)
            fused = [episode[:, : episode.shape[1] - representation.dims_beside] for episode in latents]
            data = Demonstrations(latents, fused, stages, position, gripper, fps)
            results += compare(data, config.discovery, seed, methods)
        remove_leftovers(work_dir)
        compared = Origin.of(dataset).known
        write_json(work_dir / "comparison.json", [row | {"dataset": compared} for row in comparison_rows(results)])
        draw_comparison(work_dir / "comparison.png", results, stages, fps)
    return results


def _methods(config: CompareConfig, with_signals: bool) -> list[str]:
    """Settles which methods are compared; one that lacks its signals is left out by name, or refused if asked for."""
    from lerobot_buds.evaluation import METHODS

    advice = f"{GRIP_AND_REST!r} needs --position and --gripper: which dimensions of the state these are."
    if config.methods is None:
        if not with_signals:
            logger.warning("%s It is left out.", advice)
        return [name for name in METHODS if with_signals or name != GRIP_AND_REST]
    if GRIP_AND_REST in config.methods and not with_signals:
        raise ConfigError(advice)
    return config.methods


def _signal(dataset: "LocalDataset", patterns: list[str] | None, setting: str) -> list[FloatArray]:
    """Reads the dimensions of the state that match, ``(T, d)`` per demonstration, d = 0 where nobody knows them."""
    from lerobot_buds.data import dimension_names, read_table

    names = dimension_names(dataset.features[STATE])
    dims = dims_used(setting, names, patterns, OURS[setting], others=())
    table = read_table(dataset, [STATE])
    state = table.columns[STATE].reshape(len(table.present), -1)[:, dims].astype(np.float64)
    return [state[start:end] for start, end in zip(table.starts, table.ends, strict=True)]


def main() -> None:
    """Entry point of the console script."""
    config = parse(CompareConfig)
    work_dir = Path("outputs/compare") / config.repo_id if config.work_dir is None else Path(config.work_dir)
    results = run(lambda: run_comparison(config, work_dir))
    from lerobot_buds.evaluation import comparison_table

    print(comparison_table(results), end="")
    print(f"Picture and figures are in {work_dir}.")
