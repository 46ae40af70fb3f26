"""How fast LeRobot loads the same frames, stored as video and as images."""

from collections.abc import Iterator

import numpy as np
import torch
from lerobot.datasets import LeRobotDataset

from .figures import Figure, Setting, once
from .synthetic import make_demonstrations

BATCH = 32


def measure(setting: Setting) -> Iterator[Figure]:
    """Loads frames at random, in this process and in two others."""
    for kind in ("video", "images"):
        root = setting.place / f"as_{kind}"
        make_demonstrations(root, setting.size.pixels, setting.size.frames, stages=4, video=kind == "video")
        dataset = LeRobotDataset("local/synthetic", root=root)
        loaded = _loaded_per_second(dataset)  # first: an open decoder does not survive the workers' fork
        for name, rate in (("one process", _samples_per_second(dataset)), ("two workers", loaded)):
            yield Figure(f"{kind}, {name}", rate, "frames/s", f"video, {name}" if kind == "images" else "")
        size = sum(path.stat().st_size for path in root.rglob("*") if path.is_file())
        yield Figure(f"{kind}, on disk", size / 1024 / len(dataset), "KiB a frame")


def _samples_per_second(dataset: LeRobotDataset) -> float:
    order = np.random.default_rng(0).integers(len(dataset), size=len(dataset)).tolist()
    dataset[0]
    return len(order) / once(lambda: [dataset[index] for index in order])


def _loaded_per_second(dataset: LeRobotDataset) -> float:
    loader = torch.utils.data.DataLoader(dataset, BATCH, shuffle=True, num_workers=2, persistent_workers=True)
    list(loader)  # starts the workers and opens their decoders
    return len(dataset) / once(lambda: list(loader))
