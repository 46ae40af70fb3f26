"""``lerobot-buds-compare``: compares segmentation methods on a dataset whose true stages are known."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from lerobot_buds.core import (
    ACTION,
    STATE,
    TRUE_STAGE,
    ConfigError,
    DatasetError,
    FloatArray,
    near_names,
    remove_leftovers,
    select_dims,
    write_json,
)
from lerobot_buds.data import LocalDataset, check_demonstrations, dimension_names, only_writer, read_table
from lerobot_buds.evaluation import (
    METHODS,
    Demonstrations,
    Result,
    compare,
    comparison_rows,
    comparison_table,
    draw_comparison,
)
from lerobot_buds.representation import RepresentationConfig, encode_dataset, train_representation
from lerobot_buds.segmentation import DiscoveryConfig

from .datasets import DatasetOptions, true_stages
from .running import parse, run


@dataclass
class CompareConfig(DatasetOptions):
    """Settings of a comparison; the dataset needs the column ``true_stage``, as scripted demonstrations have it."""

    work_dir: Path | None = None
    """Keeps the representations and the results; None for ``outputs/compare/`` and the dataset's name."""

    seeds: int = 3
    """Number of seeds, from 0: each trains its own representation and clusters with it."""

    methods: list[str] = field(default_factory=lambda: list(METHODS))
    """Methods to compare; all by default."""

    position: list[str] = field(default_factory=lambda: ["eef*"])
    """Shell-style patterns of the ``observation.state`` names that are the hand's position."""

    gripper: list[str] = field(default_factory=lambda: ["gripper*"])
    """The same of the gripper's fingers, whose mean size is its opening."""

    representation: RepresentationConfig = field(default_factory=RepresentationConfig)
    """Settings of the representation, but for its seed."""

    discovery: DiscoveryConfig = field(default_factory=DiscoveryConfig)
    """Settings of skill discovery, but for its seed."""


def run_comparison(config: CompareConfig, work_dir: Path) -> list[Result]:
    """Trains what is missing, compares all methods on all seeds and leaves the results in the working folder.

    Raises:
        ConfigError: A setting cannot work, or ruptures is missing.
        DatasetError: The dataset is damaged or incomplete, its true stages are not known, or another process is at the
            same work.
        SegmentationError: It cannot be segmented as asked.
    """
    if config.seeds < 1:
        raise ConfigError(f"seeds={config.seeds} cannot work; it must be at least 1.")
    dataset = config.open()
    if TRUE_STAGE not in dataset.features:
        raise DatasetError(f"{dataset.root} has no column {TRUE_STAGE!r}: no segmentation can be scored.")
    dataset.require([STATE, ACTION])
    signals = {name: _signal(dataset, getattr(config, name), name) for name in ("position", "gripper")}
    gripper = [np.abs(fingers).sum(axis=1) / max(1, fingers.shape[1]) for fingers in signals["gripper"]]
    check_demonstrations(dataset, config.representation.cameras, side=config.representation.side)
    stages, fps = true_stages(dataset), dataset.fps
    results: list[Result] = []
    with only_writer(work_dir):
        for seed in range(config.seeds):
            settings, folder = replace(config.representation, seed=seed), work_dir / f"representation_{seed}"
            remove_leftovers(folder)
            representation = train_representation(dataset, settings, folder)
            latents = encode_dataset(dataset, representation)
            fused = [episode[:, : episode.shape[1] - representation.dims_beside] for episode in latents]
            data = Demonstrations(latents, fused, stages, signals["position"], gripper, fps)
            results += compare(data, config.discovery, seed, config.methods)
        remove_leftovers(work_dir)
        write_json(work_dir / "comparison.json", comparison_rows(results))
        draw_comparison(work_dir / "comparison.png", results, stages, fps)
    return results


def _signal(dataset: LocalDataset, patterns: list[str], setting: str) -> list[FloatArray]:
    """Reads the dimensions of the state that match, ``(T, d)`` per demonstration."""
    names = dimension_names(dataset.features[STATE])
    for pattern in patterns:
        if not select_dims(names, [pattern]):
            raise ConfigError(
                f"{setting}: {pattern!r} matches no dimension of the state. {near_names(pattern, names)} Say which are "
                f"meant with --{setting}='[...]', or that there are none with --{setting}='[]'."
            )
    dims = select_dims(names, patterns)
    table = read_table(dataset, [STATE])
    state = table.columns[STATE].reshape(len(table.present), -1)[:, dims].astype(np.float64)
    return [state[start:end] for start, end in zip(table.starts, table.ends, strict=True)]


def main() -> None:
    """Entry point of the console script."""
    config = parse(CompareConfig)
    work_dir = Path("outputs/compare") / config.repo_id if config.work_dir is None else Path(config.work_dir)
    results = run(lambda: run_comparison(config, work_dir))
    print(comparison_table(results), end="")
    print(f"Picture and figures are in {work_dir}.")
