import os
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("HF_HUB_OFFLINE", "1")

import numpy as np
import pytest

from lerobot_buds.core import COLLECTION_FILE, write_json
from lerobot_buds.segmentation import SegmentationRecord, write_segmented_dataset

Demonstrations = tuple[list[np.ndarray], list[np.ndarray]]


@pytest.fixture(scope="session")
def demonstrations() -> Callable[..., Demonstrations]:
    """Makes latents of demonstrations that visit known stages, with their true labels."""

    def make(count: int = 6, stages: int = 3, dims: int = 8, seed: int = 0, noise: float = 0.3) -> Demonstrations:
        rng = np.random.default_rng(seed)
        centres = rng.normal(size=(stages + 1, dims)) * 3
        latents, truth = [], []
        for _ in range(count):
            lengths = rng.integers(40, 90, size=stages)
            stage = np.repeat(np.arange(stages), lengths)
            along = np.concatenate([np.linspace(0, 1, n, endpoint=False) for n in lengths])[:, None]
            path = centres[stage] + 0.3 * along * (centres[stage + 1] - centres[stage])
            latents.append(path + noise * rng.normal(size=path.shape))
            truth.append(stage.astype(np.int64))
        return latents, truth

    return make


LENGTHS = (25, 6, 30)
FPS = 10


@pytest.fixture(scope="session")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of three demonstrations with one small camera, recorded by LeRobot; tests only read it."""
    from lerobot.datasets import LeRobotDataset

    rng = np.random.default_rng(0)
    root = tmp_path_factory.mktemp("segmentation") / "source"
    camera = {"dtype": "image", "shape": (8, 8, 3), "names": ["height", "width", "channels"]}
    features = {
        "observation.images.front": camera,
        "observation.state": {"dtype": "float32", "shape": (3,), "names": ["x.pos", "y.pos", "gripper.pos"]},
        "action": {"dtype": "float32", "shape": (2,), "names": ["x", "y"]},
        "true_stage": {"dtype": "int64", "shape": (1,), "names": None},
    }
    dataset = LeRobotDataset.create("test/source", FPS, features, root=root, use_videos=False)
    for length in LENGTHS:
        for t in range(length):
            dataset.add_frame(
                {
                    "observation.images.front": rng.integers(0, 256, (8, 8, 3), dtype=np.uint8),
                    "observation.state": rng.normal(size=3).astype(np.float32),
                    "action": rng.normal(size=2).astype(np.float32),
                    "true_stage": np.array([t // 10], dtype=np.int64),
                    "task": "close the drawer",
                }
            )
        dataset.save_episode()
    dataset.finalize()
    write_json(root / COLLECTION_FILE, {"seed": 7})
    return root


@pytest.fixture(scope="session")
def record() -> SegmentationRecord:
    """A segmentation of the dataset `source`."""
    labels = [np.repeat([0, 1], [10, 15]), np.repeat([1], 6), np.repeat([2, 0, 1], [9, 9, 12])]
    return SegmentationRecord.of_labels(
        labels,
        repo_id="test/source",
        fps=FPS,
        horizon=4,
        parameters={"window_s": 0.5, "n_skills": None},
        seeds={"discovery": 3},
        representation={"sha256": "ab" * 32},
        agreement={"nmi": 0.5},
    )


@pytest.fixture(scope="session")
def segmented(source: Path, record: SegmentationRecord, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset `source` with labels; tests only read it."""
    target = tmp_path_factory.mktemp("segmentation") / "segmented"
    write_segmented_dataset(source, target, "test/segmented", record)
    return target
