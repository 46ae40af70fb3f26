"""Datasets of any layout, recorded by LeRobot alone."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lerobot_buds.cli.segment import SegmentConfig, segment
from lerobot_buds.core import ACTION, IMAGE_PREFIX, STATE, BudsError, sha256_of_file
from lerobot_buds.representation import RepresentationConfig
from lerobot_buds.segmentation import DiscoveryConfig

FRONT = f"{IMAGE_PREFIX}front"
NAMES = ["joint_1.pos", "gripper.pos", "eef_x.pos", "eef_y.pos"]


def make_dataset(
    root: Path,
    lengths: Sequence[int] = (30, 25),
    cameras: dict[str, tuple[int, ...]] | None = None,
    state: dict[str, Any] | None = None,
    fps: int = 20,
    video: bool = False,
    tasks: Sequence[str] = ("sort the colours",),
    offset: float = 0.0,
    **create: Any,
) -> Path:
    """Records noise around one colour and one place in the first half of every episode, others in the second.

    Args:
        root: Folder of the dataset.
        lengths: Frames of the episodes.
        cameras: Shapes of the image features, channels first or last; one small camera by default.
        state: Shape and names of the state; four named dimensions by default, no state where the shape is empty.
        fps: Frame rate.
        video: Stores the cameras as videos.
        tasks: What the episodes do, in turn.
        offset: Added to the state.
        **create: More arguments of LeRobot's `create`.
    """
    from lerobot.datasets import LeRobotDataset

    cameras = {FRONT: (32, 32, 3)} if cameras is None else cameras
    state = {"shape": (4,), "names": NAMES} if state is None else state
    features: dict[str, Any] = {ACTION: {"dtype": "float32", "shape": (2,), "names": ["x", "y"]}}
    if state["shape"]:
        features[STATE] = {"dtype": "float32", **state}
    for name, shape in cameras.items():
        names = ["height", "width", "channels"] if shape[2] == 3 else ["channels", "height", "width"]
        features[name] = {"dtype": "video" if video else "image", "shape": shape, "names": names}
    if video:  # quicker than a pool of processes, and no frame is dropped
        create |= {"streaming_encoding": True, "encoder_queue_maxsize": max(lengths)}
    dataset = LeRobotDataset.create("tests/foreign", fps, features, root=root, use_videos=video, **create)
    rng = np.random.default_rng(0)
    for number, length in enumerate(lengths):
        for t in range(length):
            stage = 2 * t // length
            frame: dict[str, Any] = {
                name: np.clip(rng.normal(60 + 120 * stage, 12, shape), 0, 255).astype(np.uint8)
                for name, shape in cameras.items()
            }
            if state["shape"]:
                frame[STATE] = rng.normal(stage + offset, 0.1, state["shape"]).astype(features[STATE]["dtype"])
            frame[ACTION] = rng.normal(size=2).astype(np.float32)
            dataset.add_frame({**frame, "task": tasks[number % len(tasks)]})
        dataset.save_episode()
    dataset.finalize()
    return root


def settings(source: Path, folder: Path, **changes: Any) -> SegmentConfig:
    """The smallest pass over a dataset; output and work lie in the folder."""
    places = {"output_root": str(folder / "skills"), "work_dir": str(folder / "work")}
    return SegmentConfig(
        repo_id="tests/foreign",
        root=str(source),
        representation=RepresentationConfig(
            **{"image_size": 16, "latent_dim": 4, "steps": 2, "batch_size": 16, "device": "cpu"}
            | changes.pop("representation", {})
        ),
        discovery=DiscoveryConfig(
            **{"window_s": 0.2, "max_skills": 3, "min_skill_s": 0.2} | changes.pop("discovery", {})
        ),
        **places | changes,
    )


def hashes(root: Path) -> dict[str, str]:
    """The hash of every file below a folder, but of the empty ones that lock it."""
    files = [path for path in sorted(root.rglob("*")) if path.is_file() and path.suffix != ".lock"]
    return {str(path.relative_to(root)): sha256_of_file(path) for path in files}


@pytest.fixture
def refused(tmp_path: Path) -> Callable[..., str]:
    """Runs a pass that must be refused, all its files below `tmp_path`; returns the message."""

    def run(source: Path, error: type[BudsError], **changes: Any) -> str:
        before = {**hashes(source), **hashes(tmp_path)}
        with pytest.raises(error) as caught:
            segment(settings(source, tmp_path, **changes))
        # Neither a trained representation, nor a target, nor a part of one.
        assert {**hashes(source), **hashes(tmp_path)} == before
        return str(caught.value)

    return run


@pytest.fixture(scope="session", name="make_dataset")
def _make_dataset() -> Callable[..., Path]:
    return make_dataset


@pytest.fixture(scope="session", name="settings")
def _settings() -> Callable[..., SegmentConfig]:
    return settings


@pytest.fixture(scope="session", name="hashes")
def _hashes() -> Callable[[Path], dict[str, str]]:
    return hashes
