import os

os.environ.setdefault("HF_HUB_OFFLINE", "1")

from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDataset

# Two threads that wait for each other on a busy machine made these small networks ten times slower.
torch.set_num_threads(1)

FRONT = "observation.images.front"
WRIST = "observation.images.wrist"
STATE_NAMES = ["joint_1.pos", "gripper_left.pos", "eef_x.pos", "eef_y.pos"]


@pytest.fixture(scope="session")
def toy_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four episodes of a bright square that moves along a line; the state holds its place."""
    rng = np.random.default_rng(0)
    root = tmp_path_factory.mktemp("representation") / "toy"
    image = {"dtype": "image", "shape": (32, 32, 3), "names": ["height", "width", "channels"]}
    features = {
        FRONT: image,
        WRIST: image,
        "observation.state": {"dtype": "float32", "shape": (4,), "names": STATE_NAMES},
        "action": {"dtype": "float32", "shape": (2,), "names": ["x", "y"]},
    }
    dataset = LeRobotDataset.create("test/toy", 10, features, root=root, use_videos=False)
    for length in (12, 9, 10, 11):
        start, speed = rng.uniform(0, 8), rng.uniform(0.5, 1.5)
        for t in range(length):
            x = start + speed * t
            pictures = rng.integers(0, 30, (2, 32, 32, 3), dtype=np.uint8)
            pictures[:, 8:16, int(x) : int(x) + 8] = (220, 120, 40)
            state = np.array([rng.normal(), x > 9, x, 1.0], dtype=np.float32)
            frame = {FRONT: pictures[0], WRIST: pictures[1], "observation.state": state}
            dataset.add_frame({**frame, "action": np.zeros(2, dtype=np.float32), "task": "slide"})
        dataset.save_episode()
    dataset.finalize()
    return root
