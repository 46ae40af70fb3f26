"""A tiny segmented dataset, as a robot records it: two 32-pixel cameras; labels and subgoals are frames' columns."""

import logging
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

# Read by LeRobot when it is imported: nothing here may reach for the Hub.
os.environ.setdefault("HF_HUB_OFFLINE", "1")

from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.policies import make_policy

from lerobot_buds.core import (
    ACTION,
    EYE_IN_HAND_CAMERA,
    SKILL_ID,
    STATE,
    SUBGOAL_INDEX,
    TRUE_STAGE,
    WORKSPACE_CAMERA,
    subgoals_of,
)
from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.modeling_buds import BudsPolicy
from lerobot_buds.segmentation import SegmentationRecord

REPO_ID = "tests/segmented"
FPS = 20
HORIZON = 3
PIXELS = 32
TASK = "Close the drawer"
STATE_NAMES = ["joint_1.pos", "joint_2.pos", "gripper_left.pos", "gripper_right.pos", "eef_x.pos"]
ACTION_NAMES = ["x.pos", "y.pos", "z.pos", "gripper.pos"]
LABELS = [np.repeat([0, 1, 0], [5, 4, 3]), np.repeat([1, 0], [6, 2]), np.repeat([0, 1], [4, 6])]
SMALL = {
    "encoder": "conv",
    "norm": "group",
    "conv_channels": [8, 8],
    "keypoints": 4,
    "image_feature": 8,
    "subgoal_dim": 4,
    "head_widths": [16],
    "meta_latent": 4,
    "meta_encoder_widths": [16],
    "meta_head_widths": [16],
    "meta_conv_feature": 8,
    "device": "cpu",
}

torch.set_num_threads(1)


def _features() -> dict[str, dict[str, object]]:
    image = {"dtype": "image", "shape": (PIXELS, PIXELS, 3), "names": ["height", "width", "channels"]}
    column = {"dtype": "int64", "shape": (1,), "names": None}
    return {
        WORKSPACE_CAMERA: image,
        EYE_IN_HAND_CAMERA: image,
        STATE: {"dtype": "float32", "shape": (len(STATE_NAMES),), "names": STATE_NAMES},
        ACTION: {"dtype": "float32", "shape": (len(ACTION_NAMES),), "names": ACTION_NAMES},
        TRUE_STAGE: column,
        SKILL_ID: column,
        SUBGOAL_INDEX: column,
    }


def _record(root: Path, fps: int = FPS, repeats: int = 1) -> LeRobotDatasetMetadata:
    """Writes a dataset into the new folder `root`: `repeats` times episodes with the skills of `LABELS`."""
    episodes = LABELS * repeats
    rng = np.random.default_rng(0)
    dataset = LeRobotDataset.create(REPO_ID, fps, _features(), root=root, use_videos=False)
    start = 0
    for labels in episodes:
        subgoals = start + subgoals_of(labels, HORIZON)
        for label, subgoal in zip(labels, subgoals, strict=True):
            # The colour tells the skill, so that ids can be learnt; and the first joint the action, but for noise.
            image = rng.integers(0, 100, (PIXELS, PIXELS, 3))
            image[..., label] += 150
            state = rng.normal(size=len(STATE_NAMES)).astype(np.float32)
            noise = rng.uniform(-0.3, 0.3, len(ACTION_NAMES))
            frame = {
                WORKSPACE_CAMERA: image.astype(np.uint8),
                EYE_IN_HAND_CAMERA: rng.integers(0, 256, (PIXELS, PIXELS, 3)).astype(np.uint8),
                STATE: state,
                ACTION: (0.7 * np.tanh(2 * state[0]) + noise).astype(np.float32),
                TRUE_STAGE: np.array([7]),
                SKILL_ID: np.array([label]),
                SUBGOAL_INDEX: np.array([subgoal]),
            }
            dataset.add_frame({**frame, "task": TASK})
        dataset.save_episode()
        start += len(labels)
    dataset.finalize()
    SegmentationRecord.of_labels(episodes, repo_id=REPO_ID, fps=fps, horizon=HORIZON).write(root)
    return LeRobotDatasetMetadata(REPO_ID, root=root)


@pytest.fixture(scope="session")
def record() -> Callable[..., LeRobotDatasetMetadata]:
    return _record


@pytest.fixture(scope="session")
def meta(tmp_path_factory: pytest.TempPathFactory) -> LeRobotDatasetMetadata:
    """Metadata of the dataset that most tests use: three episodes."""
    return _record(tmp_path_factory.mktemp("data") / "segmented")


@pytest.fixture(scope="session")
def dataset_root(meta: LeRobotDatasetMetadata) -> Path:
    return Path(meta.root)


@pytest.fixture(autouse=True)
def cache_in_tmp(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lerobot_buds.data.store.HF_LEROBOT_HOME", tmp_path_factory.getbasetemp() / "home")


@pytest.fixture
def build(meta: LeRobotDatasetMetadata) -> Callable[..., BudsPolicy]:
    """Builds small policies on the dataset through LeRobot's own factory; keyword arguments override the sizes."""

    def build(**overrides: Any) -> BudsPolicy:
        torch.manual_seed(0)
        return make_policy(BudsConfig(**{**SMALL, **overrides}), ds_meta=meta)

    return build


@pytest.fixture
def batch_of(dataset_root: Path) -> Callable[..., dict[str, Any]]:
    """Loads rows of the dataset as LeRobot's data loader collates them."""
    dataset = LeRobotDataset(REPO_ID, root=dataset_root)

    def batch_of(*rows: int) -> dict[str, Any]:
        return torch.utils.data.default_collate([dataset[row] for row in rows])

    return batch_of


@pytest.fixture
def labels() -> list[np.ndarray]:
    return LABELS


@pytest.fixture
def horizon() -> int:
    return HORIZON


@pytest.fixture
def task() -> str:
    return TASK


@pytest.fixture
def small() -> dict[str, Any]:
    """Sizes of the small networks, as settings of `BudsConfig`."""
    return dict(SMALL)


@pytest.fixture
def run_script(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Runs a console script's `main` with arguments in this process, and gives the logging back that it takes over."""

    def run_script(main: Callable[[], object], *arguments: object) -> None:
        logger = logging.getLogger()
        level, handlers = logger.level, list(logger.handlers)
        monkeypatch.setattr(sys, "argv", [main.__module__, *map(str, arguments)])
        try:
            main()
        finally:
            logger.setLevel(level)
            logger.handlers[:] = handlers

    return run_script


@pytest.fixture
def command() -> Callable[..., list[str]]:
    """Writes the arguments of ``lerobot-train`` for small policies on a dataset; settings are those of its options."""

    def command(root: Path, **settings: Any) -> list[str]:
        options = {"policy.type": "buds", **{f"policy.{key}": value for key, value in SMALL.items()}}
        options |= {"dataset.repo_id": REPO_ID, "dataset.root": root, "num_workers": 0, "log_freq": 1, "seed": 1}
        return [f"--{key}={value}" for key, value in {**options, **settings}.items()]

    return command
