"""What demonstrations would do in the state of a rollout: to judge decisions by, or to put in their place.

torch and LeRobot are imported on use.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import (
    COLLECTION_FILE,
    IMAGE_PREFIX,
    STATE,
    TRUE_STAGE,
    CheckpointError,
    DatasetError,
    FloatArray,
    IntArray,
    same_rate,
)
from lerobot_buds.envs import Task

from .neighbors import NEIGHBORS, DemonstrationFrames, Mask

if TYPE_CHECKING:
    from lerobot_buds.policy import BudsConfig
    from lerobot_buds.representation import Representation
    from lerobot_buds.segmentation import SegmentationRecord

META_CONTROLLER = "meta_controller"
"""The policy decides for itself."""
DEMONSTRATIONS = "demonstrations"
"""The demonstrations nearest to the state decide."""
STAGES = "stages"
"""Those decide that are nearest among the ones in the same true stage."""
SKILL_SOURCES = (META_CONTROLLER, DEMONSTRATIONS, STAGES)
"""Who may choose the skill."""
SUBGOAL_SOURCES = (META_CONTROLLER, DEMONSTRATIONS)
"""Who may choose the subgoal."""


@dataclass(frozen=True)
class Advice:
    """What to do at a decision.

    Attributes:
        skill: The skill.
        foreign: Whether the nearest demonstrations do not use it there; None where none were asked.
        goal: Absolute index of the frame that is its subgoal; None to keep the meta controller's.
    """

    skill: int
    foreign: bool | None = None
    goal: int | None = None


@dataclass(frozen=True)
class Guide:
    """Segmented demonstrations of one task.

    Attributes:
        frames: Their frames in the latent space.
        goals: What the policy makes subgoals of, for all frames: ``(N, 3, h, w)`` uint8 workspace images at the size
            that it sees, or ``(N, z)`` float32 latents.
        stages: ``(N,)`` int64 number of the task's stage in which a frame is; empty where nobody knows.
        representation: Makes the latents.
        labels: Hash of their labels.
        neighbors: Demonstrations that are asked at a decision.
    """

    frames: DemonstrationFrames
    goals: NDArray[np.uint8] | NDArray[np.float32]
    stages: IntArray
    representation: "Representation"
    labels: str
    neighbors: int = NEIGHBORS

    @classmethod
    def open(
        cls,
        root: Path,
        task: Task,
        config: "BudsConfig",
        neighbors: int = NEIGHBORS,
        renamed: Mapping[str, str] | None = None,
    ) -> Self:
        """Opens the segmented dataset that a policy was trained on.

        Args:
            root: Its folder, whole on this machine.
            task: The task whose demonstrations are to be asked.
            config: The policy's settings.
            neighbors: Demonstrations that are asked at a decision.
            renamed: Name of a camera in the dataset -> the policy's, where these differ.

        Raises:
            SegmentationError: It is not segmented, or its labels are out of step.
            CheckpointError: The policy was trained on other labels, or at another frame rate.
            DatasetError: It is damaged or incomplete, or has no demonstration of the task.
        """
        from lerobot_buds.data import LocalDataset, cached_frames
        from lerobot_buds.representation import encode_dataset
        from lerobot_buds.segmentation import SkillModel, load_labels

        record, skills, subgoals = load_labels(root)
        _check_labels(root, record, config)
        starts, ends = _demonstrations_of(root, task)
        representation = SkillModel.from_pretrained(root).representation
        latents = np.concatenate(encode_dataset(root, representation))
        representation.network.to(str(config.device))
        frames = DemonstrationFrames(latents, starts, ends, skills, subgoals, record.n_skills, config.meta_period)
        stages = _stages(root, task) if TRUE_STAGE in LocalDataset(root).features else np.empty(0, dtype=np.int64)
        if config.subgoal_space == "latent":
            return cls(frames, latents.astype(np.float32), stages, representation, record.labels_hash, neighbors)
        stored = LocalDataset(root).features
        known = {old: new for old, new in (renamed or {}).items() if old in stored}
        goals = cached_frames(LocalDataset(root, renamed=known), config.stacked_cameras[0], size=config.image_shape)
        return cls(frames, goals, stages, representation, record.labels_hash, neighbors)

    def latents(self, observation: dict[str, Any], rows: IntArray) -> FloatArray:
        """Encodes what some environments see now, ``(D, z)``.

        Args:
            observation: Batch of observations of the vector environment.
            rows: ``(D,)`` the environments.

        Raises:
            CheckpointError: The observations are of another size than the dataset's.
        """
        from lerobot_buds.representation import encode_observations

        images = {IMAGE_PREFIX + camera: pixels[rows] for camera, pixels in observation["pixels"].items()}
        channels_first = {name: image.transpose(0, 3, 1, 2) for name, image in images.items()}
        return encode_observations(self.representation, channels_first | {STATE: observation["agent_pos"][rows]})

    def advise(
        self, latent: FloatArray, proposed: int, possible: Sequence[int], skills_from: str, subgoals_from: str
    ) -> Advice:
        """Makes one decision.

        Args:
            latent: ``(z,)`` where the rollout is.
            proposed: Skill that the meta controller chose.
            possible: Numbers of the task's stages in which the rollout may be; without any, all frames are asked.
            skills_from: One of `SKILL_SOURCES`.
            subgoals_from: One of `SUBGOAL_SOURCES`.
        """
        distances = self.frames.distances(latent)
        nearest = self.frames.nearest(distances, self.neighbors)
        allowed: Mask | None = None
        if skills_from == STAGES and possible:
            allowed = np.isin(self.stages, possible)
        asked = nearest if allowed is None else self.frames.nearest(distances, self.neighbors, allowed)
        skill = proposed
        if skills_from != META_CONTROLLER and len(asked):
            skill = self.frames.majority_skill(asked)
        goal = self.frames.subgoal_frame(skill, distances, allowed) if subgoals_from == DEMONSTRATIONS else None
        return Advice(skill, self.frames.is_foreign(skill, nearest), goal)


def _check_labels(root: Path, record: "SegmentationRecord", config: "BudsConfig") -> None:
    if config.skills != "segments":
        raise CheckpointError(
            f"The policy was trained with skills={config.skills!r}, so labels say nothing about it: leave "
            "dataset_root out."
        )
    if config.segmentation is not None and config.segmentation not in record.lineage:
        raise CheckpointError(
            f"The policy was trained on other labels than those of {root}; its skills mean something else. Give the "
            "segmented dataset that it was trained on."
        )
    skills, fps = record.n_skills, record.source.fps
    if config.n_skills != skills:
        raise CheckpointError(f"The policy was trained with skills={config.n_skills}, {root} has {skills}.")
    if config.fps is None or not same_rate(config.fps, fps):
        raise CheckpointError(f"The policy was trained with fps={config.fps}, {root} has {fps}.")


def _demonstrations_of(root: Path, task: Task) -> tuple[IntArray, IntArray]:
    """Finds the first frames, and one past the last ones, of the demonstrations of a task, ``(E,)`` each."""
    from lerobot_buds.data import LocalDataset

    episodes = [e for e in LocalDataset(root).episodes if task.description in e["tasks"]]
    if not episodes:
        raise DatasetError(f"{root} has no demonstration of {task.description!r} ({task.name}).")
    bounds = np.array([[e["dataset_from_index"], e["dataset_to_index"]] for e in episodes], dtype=np.int64)
    return bounds[:, 0], bounds[:, 1]


def _stages(root: Path, task: Task) -> IntArray:
    """Reads the stage of every frame by its number in the task; the dataset counts the stages of all its tasks."""
    from lerobot_buds.data import read_collection, read_table

    names = read_collection(root).get("stages", [])
    if not set(task.stages) <= set(names):
        return np.empty(0, dtype=np.int64)
    numbers = np.array([task.stages.index(name) if name in task.stages else -1 for name in names], dtype=np.int64)
    stored = read_table(root, [TRUE_STAGE]).columns[TRUE_STAGE].astype(np.int64)  # of whatever number type
    if len(stored) and not 0 <= stored.min() <= stored.max() < len(names):
        raise DatasetError(
            f"{root}: {TRUE_STAGE!r} goes from {stored.min()} to {stored.max()}, but {COLLECTION_FILE} names "
            f"{len(names)} stages; fetch the dataset again, or leave dataset_root out."
        )
    stages: IntArray = numbers[stored]
    return stages
