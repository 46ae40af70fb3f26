"""Times LeRobot's loading of the same demonstrations, stored as video and as images.

Records a few demonstrations twice, then draws frames at random. Quote the ratios.

    python scripts/benchmark_loading.py
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from lerobot.datasets import LeRobotDataset

from lerobot_buds.cli.collect import CollectConfig, collect

EPISODES, SAMPLES, BATCH = 3, 400, 32


def recorded(folder: Path, video: bool) -> LeRobotDataset:
    """Records demonstrations from the same seeds, in one of the two ways."""
    name = f"local/{'video' if video else 'images'}"
    collect(CollectConfig(name, episodes=EPISODES, root=str(folder / name), video=video))
    return LeRobotDataset(name, root=folder / name)


def samples_per_second(dataset: LeRobotDataset) -> float:
    """Draws single samples at random in this process."""
    order = np.random.default_rng(0).integers(len(dataset), size=SAMPLES).tolist()
    dataset[0]
    began = time.perf_counter()
    for index in order:
        dataset[index]
    return SAMPLES / (time.perf_counter() - began)


def loaded_per_second(dataset: LeRobotDataset) -> float:
    """Draws shuffled batches in two loader processes, after their start."""
    loader = torch.utils.data.DataLoader(dataset, BATCH, shuffle=True, num_workers=2, persistent_workers=True)
    for _ in loader:  # starts the workers and opens their decoders
        pass
    began = time.perf_counter()
    for _ in loader:
        pass
    return len(dataset) / (time.perf_counter() - began)


def main() -> None:
    """Prints both speeds and the size on disk for both kinds of storage."""
    with TemporaryDirectory() as folder:
        for video in (True, False):
            dataset = recorded(Path(folder), video)
            loaded = loaded_per_second(dataset)  # first: an open decoder does not survive the workers' fork
            size = sum(path.stat().st_size for path in Path(dataset.root).rglob("*") if path.is_file())
            print(
                f"{'video' if video else 'images'}: {samples_per_second(dataset):.0f} samples/s in one process, "
                f"{loaded:.0f} with two workers, {size / 1024 / len(dataset):.1f} KiB a frame",
                flush=True,
            )


if __name__ == "__main__":
    main()
