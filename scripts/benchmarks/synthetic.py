"""Segmented demonstrations that need no simulator: a bright bar wanders over a gradient, in as many stages as asked."""

from pathlib import Path

import numpy as np
from lerobot.datasets import LeRobotDataset

from lerobot_buds.cli.segment import SegmentConfig, segment
from lerobot_buds.core import ACTION, EYE_IN_HAND_CAMERA, STATE, TRUE_STAGE, WORKSPACE_CAMERA
from lerobot_buds.data.writing import camera_feature, create_dataset, vector_feature, write_episode
from lerobot_buds.representation import RepresentationConfig

CAMERAS = (WORKSPACE_CAMERA, EYE_IN_HAND_CAMERA)
DEMONSTRATIONS, FPS = 4, 20


def make_demonstrations(root: Path, pixels: int, frames: int, stages: int, video: bool = False) -> LeRobotDataset:
    """Writes demonstrations of two cameras, a state of twelve numbers and an action of four, with their true stages."""
    features = {
        **dict.fromkeys(CAMERAS, camera_feature((pixels, pixels, 3), video)),
        STATE: vector_feature([f"joint_{number}.pos" for number in range(12)]),
        ACTION: vector_feature(["x.pos", "y.pos", "z.pos", "gripper.pos"]),
        TRUE_STAGE: {"dtype": "int64", "shape": (1,), "names": None},
    }
    dataset = create_dataset("local/synthetic", root, FPS, features)
    rng = np.random.default_rng(0)
    gradient = np.linspace(0, 120, pixels, dtype=np.uint8)[:, None, None]
    images = np.broadcast_to(gradient, (frames, pixels, pixels, 3)).copy()
    for t in range(frames):
        left = t % (pixels - pixels // 8)
        images[t, :, left : left + pixels // 8] += 100
    for _ in range(DEMONSTRATIONS):
        columns = {
            **dict.fromkeys(CAMERAS, images),
            STATE: rng.normal(size=(frames, 12)).astype(np.float32),
            ACTION: rng.uniform(-1, 1, (frames, 4)).astype(np.float32),
            TRUE_STAGE: (np.arange(frames) * stages // frames)[:, None],
        }
        write_episode(dataset, columns, "wander")
    dataset.finalize()
    return dataset


def make_skills(root: Path, pixels: int, frames: int, skills: int) -> Path:
    """Makes a segmented dataset of so many skills, whose latents are of a representation that hardly learnt."""
    source = root / "demonstrations"
    make_demonstrations(source, pixels, frames, skills)
    segment(
        SegmentConfig(
            "local/synthetic",
            root=source,
            output_root=root / "skills",
            work_dir=root / "work",
            labels_from=TRUE_STAGE,
            representation=RepresentationConfig(steps=1, batch_size=8, image_size=pixels, device="cpu"),
        )
    )
    return root / "skills"
