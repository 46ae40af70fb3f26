"""What the dataset says about frames, by absolute index: skill, goal, gripper history, and which skills came before.

LeRobot drops custom columns on the way to the policy and always keeps ``index``; `processor_buds` joins these labels to
its batches. The tables are plain data of one process.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_buds.core import (
    ACTION,
    STATE,
    CheckpointError,
    ConfigError,
    DatasetError,
    IntArray,
    SegmentationError,
    segments_of,
    subgoals_of,
)
from lerobot_buds.data import FrameTable, LocalDataset, read_table, require_finite
from lerobot_buds.representation import Representation, encode_dataset
from lerobot_buds.segmentation import REPRESENTATION_DIR, load_labels

from .configuration_buds import BudsConfig
from .goals import GoalImages
from .pauses import is_pause

logger = logging.getLogger(__name__)

PREFIX = "labels."
"""What the names of labels in a batch begin with."""

UNDECIDED = -1
"""Stands for the skill in force before the first decision."""


@dataclass(frozen=True)
class Labels:
    """What the dataset says about the frames of a batch; in the batch under these names, with `PREFIX`.

    Goals are ``(B, d)`` float32 latents, ``(B, 3, h, w)`` uint8 images, or ``(B, 0)`` where there are none.

    Attributes:
        skill: ``(B,)`` int64 skill of the frame.
        goal: Goal of that skill.
        neighbour: ``(B,)`` int64 skill of the segment beside, where its edge is near; else `skill`.
        neighbour_goal: Goal of that skill.
        held: ``(B,)`` int64 skill that was in force one decision before, `UNDECIDED` at the start.
        held_for: ``(B,)`` int64 for how many frames.
        finished: ``(B, K)`` float32 how often every skill had been done before that one.
        history: ``(B, n, h)`` float32 gripper readings of the n frames before, oldest first.
        weight: ``(B,)`` float32 weight of `skill` in the loss.
        neighbour_weight: The same of `neighbour`.
        frame_weight: ``(B,)`` float32 weight of the frame in all losses; pauses may weigh less.
    """

    skill: Tensor
    goal: Tensor
    neighbour: Tensor
    neighbour_goal: Tensor
    held: Tensor
    held_for: Tensor
    finished: Tensor
    history: Tensor
    weight: Tensor
    neighbour_weight: Tensor
    frame_weight: Tensor

    def in_batch(self) -> dict[str, Tensor]:
        """Names the labels as they stand in a batch."""
        return {PREFIX + field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def of(cls, batch: Mapping[str, Any]) -> Self:
        """Finds the labels of a batch.

        Raises:
            DatasetError: There are none.
        """
        try:
            return cls(**{field.name: batch[PREFIX + field.name] for field in fields(cls)})
        except KeyError as error:
            raise DatasetError(
                f"The batch lacks {error}: a loss needs batches that the policy's preprocessor has seen, of the "
                "dataset that a policy was last built for in this process."
            ) from error


class LabelTable:
    """Labels, goals and gripper readings of all frames of one dataset.

    Attributes:
        shortest: ``(K,)`` int64 frames of every skill's shortest segment.
        longest: ``(K,)`` int64 frames of its longest.

    Args:
        root: Folder of the dataset, segmented if the policy has skills as labelled.
        config: A configuration that is completed.

    Raises:
        SegmentationError: The labels are missing or do not fit the dataset.
        ConfigError: Pauses are to be weighed, and there is no proprioception.
    """

    def __init__(self, root: Path, config: BudsConfig) -> None:
        self.root, self.config = Path(root), config
        dims = config.history_dims or []
        table = read_table(self.root, [ACTION, STATE] if config.state_size else [ACTION])
        self._starts, self._ends, self._present = table.starts, table.ends, table.present
        total = len(self._present)
        horizon = config.subgoal_horizon
        if config.skills == "segments":
            record, self._skill, self._goal = load_labels(self.root)
            horizon = record.horizon
        else:
            self._skill = np.where(self._present, 0, -1)
            self._goal = np.full(total, -1, dtype=np.int64)
        n_skills = config.n_skills or 1
        self._neighbour, self._neighbour_goal = self._skill.copy(), self._goal.copy()
        self._held = np.full(total, UNDECIDED, dtype=np.int64)
        self._held_for = np.zeros(total, dtype=np.int64)
        self._finished = np.zeros((total, n_skills), dtype=np.float32)
        self.shortest = np.full(n_skills, np.iinfo(np.int64).max)
        self.longest = np.ones(n_skills, dtype=np.int64)
        for start, end in zip(self._starts, self._ends, strict=True):
            self._label_episode(slice(int(start), int(end)), horizon)
        counts = np.bincount(self._skill[self._present], minlength=n_skills)
        balanced = counts.sum() / (n_skills * np.maximum(counts, 1))
        self._weight = (balanced if config.balance_skills else np.ones(n_skills)).astype(np.float32)
        self._actions = table.columns[ACTION].reshape(total, -1).astype(np.float32)
        state = table.columns[STATE].reshape(total, -1) if config.state_size else np.empty((total, 0))
        self._readings = state[:, dims].astype(np.float32)
        self._require_finite_state(table, state)
        self._frame_weight = self._weigh_pauses(state)

    def _require_finite_state(self, table: FrameTable, state: NDArray[Any]) -> None:
        used = self.config.felt_dims
        names = self.config.state_names or [str(d) for d in range(state.shape[1])]
        if used:
            columns = {STATE: state[:, used].astype(np.float32)}
            require_finite(replace(table, columns=columns), STATE, [names[d] for d in used])

    def _weigh_pauses(self, state: NDArray[Any]) -> NDArray[np.float32]:
        config, weight = self.config, np.ones(len(state), dtype=np.float32)
        if config.pause_weight == 1:
            return weight
        used = config.felt_dims
        if not used:
            raise ConfigError(f"pause_weight={config.pause_weight}: without proprioception nothing tells a pause.")
        here = [self._present[start:end].all() for start, end in zip(self._starts, self._ends, strict=True)]
        pauses = is_pause(state[:, used], self._starts[here], self._ends[here], config.pause)
        weight[pauses] = config.pause_weight
        share = pauses.sum() / max(1, self._present.sum())
        logger.info("%.1f %% of the frames are pauses and weigh %g (pause_weight).", 100 * share, config.pause_weight)
        return weight

    def _label_episode(self, rows: slice, horizon: int) -> None:
        """Fills in what follows from the skills of one episode."""
        config, labels, first = self.config, self._skill[rows], rows.start
        if len(labels) == 0 or labels[0] < 0:
            return  # not on this machine
        if config.skills != "segments":
            self._goal[rows] = self._neighbour_goal[rows] = first + subgoals_of(labels, horizon)
        segments = segments_of(labels)
        finished = np.zeros_like(self._finished[0])
        for number, (start, end, skill) in enumerate(segments):
            self.shortest[skill] = min(self.shortest[skill], end - start)
            self.longest[skill] = max(self.longest[skill], end - start)
            edge = min(config.boundary_overlap, (end - start) // 2)
            if number > 0:  # the skill before comes late: it is at its goal
                late = np.arange(first + start, first + start + edge)
                self._neighbour[late], self._neighbour_goal[late] = segments[number - 1].label, late
            if number + 1 < len(segments):  # the skill after comes early
                early = np.arange(first + end - edge, first + end)
                last = min(segments[number + 1].end, len(labels) - 1)
                self._neighbour[early] = segments[number + 1].label
                self._neighbour_goal[early] = np.minimum(early + horizon, first + last)
            decided = np.arange(start + config.meta_period, min(end + config.meta_period, len(labels)))
            self._held[first + decided] = skill
            # It came into force at a decision, not at the very edge.
            self._held_for[first + decided] = (decided - start) // config.meta_period * config.meta_period
            self._finished[first + decided] = finished
            finished[skill] += 1

    @cached_property
    def latents(self) -> NDArray[np.float32]:
        """``(N, d)`` latent of every frame in the representation that the skills were found with; NaN if not here."""
        whole = [e for e, start in enumerate(self._starts) if self._present[start]]
        dataset = LocalDataset(self.root, chosen=tuple(whole))
        parts = encode_dataset(dataset, representation_of(self.root))
        latents = np.full((len(self._present), parts[0].shape[1]), np.nan, dtype=np.float32)
        for e, part in zip(whole, parts, strict=True):
            latents[self._starts[e] : self._ends[e]] = part
        return latents

    @cached_property
    def goal_images(self) -> GoalImages:
        """Images of the workspace camera."""
        return GoalImages(self.root, self.config, self._starts)

    def holds(self, index: Tensor, actions: Tensor | None) -> bool:
        """Tells whether a batch is of this dataset, by its actions.

        Args:
            index: ``(B,)`` int64 absolute frame indices.
            actions: ``(B, ...)`` actions, the present one first; where there are none, only the indices tell.
        """
        rows = index.detach().cpu().numpy().astype(np.int64).reshape(-1)
        if len(rows) and not 0 <= rows.min() <= rows.max() < len(self._skill):
            return False
        if actions is None:
            return True
        own = self._actions[rows]
        given = actions.detach().cpu().float().numpy().reshape(len(rows), -1)[:, : own.shape[1]]
        return np.array_equal(own, given)

    def lookup(self, index: Tensor, images: Mapping[str, Tensor]) -> Labels:
        """Collects the labels of a batch.

        Args:
            index: ``(B,)`` int64 absolute frame indices.
            images: The batch's cameras, by the names of the configuration.

        Returns:
            Tensors on the CPU.

        Raises:
            CheckpointError: No camera of the dataset shows these images.
            DatasetError: An index is outside the dataset.
            SegmentationError: A frame has no label, or its goal frame is not there.
        """
        rows = index.detach().cpu().numpy().astype(np.int64).reshape(-1)
        total = len(self._skill)
        if len(rows) and (rows.min() < 0 or rows.max() >= total):
            raise DatasetError(f"{self.root}: the batch holds frame {rows.max()}, the dataset has {total} frames.")
        goals, neighbour_goals = self._goal[rows], self._neighbour_goal[rows]
        bad = (self._skill[rows] < 0) | self._is_absent(goals) | self._is_absent(neighbour_goals)
        if bad.any():
            raise SegmentationError(
                f"{self.root}: frame {rows[bad][0]} has no skill label or its subgoal frame is not on this machine. "
                "Download the whole dataset, or run lerobot-buds-segment again."
            )
        if self.config.has_subgoals and self.config.subgoal_space == "image":
            camera = self.config.stacked_cameras[0]
            if camera not in images:
                raise CheckpointError(f"The policy needs [{camera!r}], which the batch lacks. It has {sorted(images)}.")
            self.goal_images.recognise(rows, images[camera])
        starts = self._starts[np.searchsorted(self._ends, rows, side="right")]
        skill, neighbour, goal = self._skill[rows], self._neighbour[rows], self._goals(goals)
        is_same = np.array_equal(goals, neighbour_goals)
        return Labels(
            skill=torch.from_numpy(skill),
            goal=goal,
            neighbour=torch.from_numpy(neighbour),
            neighbour_goal=goal if is_same else self._goals(neighbour_goals),
            held=torch.from_numpy(self._held[rows]),
            held_for=torch.from_numpy(self._held_for[rows]),
            finished=torch.from_numpy(self._finished[rows]),
            history=torch.from_numpy(self._readings[history_rows(rows, starts, self.config.history_frames)]),
            weight=torch.from_numpy(self._weight[skill]),
            neighbour_weight=torch.from_numpy(self._weight[neighbour]),
            frame_weight=torch.from_numpy(self._frame_weight[rows]),
        )

    def _goals(self, frames: IntArray) -> Tensor:
        if not self.config.has_subgoals:
            return torch.empty(len(frames), 0)
        if self.config.subgoal_space == "latent":
            return torch.from_numpy(self.latents[frames])
        return torch.from_numpy(self.goal_images[frames])

    def _is_absent(self, frames: IntArray) -> NDArray[np.bool_]:
        outside = (frames < 0) | (frames >= len(self._present))
        absent: NDArray[np.bool_] = outside | ~self._present[np.where(outside, 0, frames)]
        return absent


def history_rows(index: IntArray, starts: IntArray, frames: int) -> IntArray:
    """Lists the frames whose gripper readings a policy has seen before each frame (released code).

    Args:
        index: ``(B,)`` absolute frame indices.
        starts: ``(B,)`` absolute index of the first frame of each one's episode, which stands in for frames before it.
        frames: Length of the history (frames).

    Returns:
        ``(B, frames)`` absolute indices ``t - frames, ..., t - 1``, oldest first; the frame itself is not among them.
    """
    rows: IntArray = np.maximum(index[:, None] - np.arange(frames, 0, -1), starts[:, None])
    return rows


def representation_of(root: Path) -> Representation:
    """Reads the representation that the skills of a segmented dataset were found with.

    Args:
        root: Folder of the dataset.

    Raises:
        SegmentationError: The dataset has none.
        CheckpointError: It is damaged.
    """
    if not (root / REPRESENTATION_DIR).is_dir():
        raise SegmentationError(
            f"{root} holds no representation to take latent subgoals from: segment its source with "
            "lerobot-buds-segment, or use --policy.subgoal_space=image."
        )
    return Representation.load(root / REPRESENTATION_DIR)
