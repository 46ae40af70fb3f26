import os
import shutil

os.environ.setdefault("HF_HUB_OFFLINE", "1")

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

CAMERAS = ("observation.images.front", "observation.images.wrist")
STATE_NAMES = ["joint_1.pos", "gripper_left.pos", "eef_x.pos", "eef_y.pos"]
FPS = 10


def record_dataset(root: Path, lengths: tuple[int, ...] = (7, 5, 6), videos: bool = True, size: int = 64) -> Path:
    """Records noise-textured frames, so that frames of different rows never look alike."""
    rng = np.random.default_rng(0)
    features = {
        camera: {
            "dtype": "video" if videos else "image",
            "shape": (size, size, 3),
            "names": ["height", "width", "channels"],
        }
        for camera in CAMERAS
    }
    features["observation.state"] = {"dtype": "float32", "shape": (4,), "names": STATE_NAMES}
    features["action"] = {"dtype": "float32", "shape": (2,), "names": ["x", "y"]}
    features["true_stage"] = {"dtype": "int64", "shape": (1,), "names": None}
    dataset = LeRobotDataset.create("test/frames", FPS, features, root=root, use_videos=videos)
    for length in lengths:
        for t in range(length):
            frame = {c: rng.integers(0, 256, (size, size, 3), dtype=np.uint8) for c in CAMERAS}
            frame["observation.state"] = rng.normal(size=4).astype(np.float32)
            frame["action"] = rng.normal(size=2).astype(np.float32)
            frame["true_stage"] = np.array([t // 3], dtype=np.int64)
            frame["task"] = "stack the blocks"
            dataset.add_frame(frame)
        dataset.save_episode()
    dataset.finalize()
    return root


@pytest.fixture(scope="session")
def video_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_dataset(tmp_path_factory.mktemp("demos") / "video")


@pytest.fixture(scope="session")
def image_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_dataset(tmp_path_factory.mktemp("demos") / "image", videos=False)


@pytest.fixture
def copy_of(tmp_path: Path) -> Callable[[Path], Path]:
    """Copies a dataset, for tests that damage it."""

    def copy(root: Path) -> Path:
        return Path(shutil.copytree(root, tmp_path / "copy"))

    return copy
