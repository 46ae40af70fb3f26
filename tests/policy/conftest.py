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
from lerobot.policies import make_policy, make_pre_post_processors

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
from lerobot_buds.policy.processor_buds import _offered
from lerobot_buds.representation import Modalities, Representation, RepresentationConfig
from lerobot_buds.segmentation import DiscoveryConfig, SegmentationRecord, SkillLibrary, SkillModel

REPO_ID = "tests/segmented"
FPS = 20
HORIZON = 3
LATENT = 3
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
    "current_state": ["*joint*"],
    "history_state": ["*gripper*"],
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
    _save_representation(root)
    return LeRobotDatasetMetadata(REPO_ID, root=root)


def _save_representation(root: Path, **changes: Any) -> Representation:
    """Puts an untrained representation and no exemplars into a dataset, as if its skills had been found with it."""
    config = RepresentationConfig(**{"image_size": 16, "latent_dim": LATENT, "device": "cpu", **changes})
    representation = Representation.untrained(Modalities.select(root, config), config)
    none = np.empty(0, dtype=np.int64)
    exemplars = SkillLibrary(np.empty((0, 1)), none, none, n_skills=2, num_keyframes=1)
    SkillModel(representation, DiscoveryConfig(), exemplars).save(root)
    return representation


def _record_robot(
    root: Path,
    states: list[np.ndarray],
    actions: list[np.ndarray],
    state_names: list[str] | None = None,
    action_names: list[str] | None = None,
    cameras: dict[str, tuple[int, int, int]] | None = None,
    fps: float = 30,
    task: str = TASK,
) -> LeRobotDatasetMetadata:
    """Writes demonstrations of any robot: an episode for each pair of ``(T, D)`` states and ``(T, A)`` actions."""
    cameras = cameras or {"observation.images.front": (PIXELS, PIXELS, 3)}
    vectors = {STATE: (states, state_names), ACTION: (actions, action_names)}
    features: dict[str, dict[str, Any]] = {
        key: {"dtype": "image", "shape": shape, "names": ["height", "width", "channels"]}
        for key, shape in cameras.items()
    }
    for key, (values, names) in vectors.items():
        features[key] = {"dtype": values[0].dtype.name, "shape": values[0].shape[1:], "names": names}
    dataset = LeRobotDataset.create("tests/robot", fps, features, root=root, use_videos=False)
    for episode in zip(states, actions, strict=True):
        for t, (state, action) in enumerate(zip(*episode, strict=True)):
            images = {key: np.full(shape, 5 * t % 256, dtype=np.uint8) for key, shape in cameras.items()}
            dataset.add_frame({**images, STATE: state, ACTION: action, "task": task})
        dataset.save_episode()
    dataset.finalize()
    return LeRobotDatasetMetadata("tests/robot", root=root)


@pytest.fixture(scope="session")
def record_robot() -> Callable[..., LeRobotDatasetMetadata]:
    return _record_robot


@pytest.fixture(scope="session")
def record() -> Callable[..., LeRobotDatasetMetadata]:
    return _record


@pytest.fixture(scope="session")
def save_representation() -> Callable[..., Representation]:
    return _save_representation


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


@pytest.fixture(autouse=True)
def no_labels_of_other_tests() -> None:
    _offered.clear()


@pytest.fixture
def build(meta: LeRobotDatasetMetadata) -> Callable[..., BudsPolicy]:
    """Builds small policies on the dataset through LeRobot's own factory; keyword arguments override the sizes."""

    def build(**overrides: Any) -> BudsPolicy:
        torch.manual_seed(0)
        return make_policy(BudsConfig(**{**SMALL, **overrides}), ds_meta=meta)

    return build


@pytest.fixture
def batch_of(dataset_root: Path) -> Callable[..., dict[str, Any]]:
    """Loads rows of the dataset as LeRobot's loader and preprocessor do, with the labels of the policy built last."""
    dataset = LeRobotDataset(REPO_ID, root=dataset_root)
    prepare, _ = make_pre_post_processors(BudsConfig(**SMALL))

    def batch_of(*rows: int) -> dict[str, Any]:
        return prepare(torch.utils.data.default_collate([dataset[row] for row in rows]))

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


SO101 = ["shoulder_pan.pos", "shoulder_lift.pos", "elbow_flex.pos", "wrist_flex.pos", "wrist_roll.pos", "gripper.pos"]


@pytest.fixture(scope="session")
def so101(tmp_path_factory: pytest.TempPathFactory) -> LeRobotDatasetMetadata:
    """An arm as LeRobot's own: degrees, 30 Hz, two cameras, a gripper that is told 0 or 100."""
    cameras = {f"observation.images.{name}": (16, 16, 3) for name in ("front", "wrist")}
    rng = np.random.default_rng(0)
    paths = []
    for _ in range(3):
        turns = np.linspace(0, 2 * np.pi, 30)[:, None] * rng.uniform(0.5, 2, 5) + rng.uniform(0, 6, 5)
        joints = np.clip(1.3 * np.sin(turns), -1, 1) * [90, 60, 45, 30, 5] + [0, -40, 60, 0, 100]  # halts at the ends
        paths.append(np.hstack([joints, 50 + 0.5 * joints[:, :1]]).astype(np.float32))
    told = [np.hstack([path[:, :5], 100.0 * (path[:, :1] > 0)]).astype(np.float32) for path in paths]
    return _record_robot(tmp_path_factory.mktemp("so101") / "data", paths, told, SO101, SO101, cameras, task="Pick")


@pytest.fixture(scope="session")
def so101_policy(so101: LeRobotDatasetMetadata, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Flat behaviour cloning of that arm, trained until it is good."""
    torch.manual_seed(0)
    config = {**SMALL, "skills": "flat", "head_widths": [128, 128], "optimizer_lr": 5e-3, "crop_padding": 0}
    config |= {"current_state": None, "history_state": None}
    policy = make_policy(BudsConfig(**config), ds_meta=so101).train()
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    dataset = LeRobotDataset("tests/robot", root=so101.root)
    prepare, finish = make_pre_post_processors(policy.config, dataset_stats=so101.stats)
    batch = prepare(torch.utils.data.default_collate(list(dataset)))
    steps = 400
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        loss, _ = policy(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        decay.step()
    folder = tmp_path_factory.mktemp("so101") / "policy"
    for part in (policy, prepare, finish):
        part.save_pretrained(folder)
    return folder
