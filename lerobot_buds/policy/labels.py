"""Looks up what LeRobot's batch does not carry: skill, goal image and gripper history of frames, by absolute index.

LeRobot drops custom columns on the way to the policy, and always keeps ``index``. The tables are plain data of one
process, never parameters or buffers, which would be broadcast and saved with the weights.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_buds.core import (
    STATE,
    DatasetError,
    IntArray,
    SegmentationError,
    segments_of,
    subgoals_of,
)
from lerobot_buds.data import read_table
from lerobot_buds.segmentation import load_labels

from .configuration_buds import BudsConfig
from .goals import GoalFrames


@dataclass(frozen=True)
class Supervision:
    """What the dataset says about the frames of a batch.

    Attributes:
        skill: ``(B,)`` int64 skill labels.
        subgoal: ``(B,)`` int64 absolute indices of the subgoal frames; on the CPU.
        ending: ``(B,)`` bool, whether the segment ends before the meta controller's next decision.
        history: ``(B, n, h)`` float32 gripper readings of the n frames before, oldest first.
    """

    skill: Tensor
    subgoal: Tensor
    ending: Tensor
    history: Tensor


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


class LabelTable:
    """Labels, goal frames and gripper readings of one dataset.

    Attributes:
        skill: ``(N,)`` int64 skill of every frame, -1 for frames that are not on this machine.
        goals: Goal images; None for a policy without subgoals.
        weights: ``(K,)`` float64 weights by which every skill counts the same, 1 for all if they have as many frames.

    Args:
        root: Folder of the dataset, segmented if the policy has skills as labelled.
        config: A configuration whose features and dimensions are settled.

    Raises:
        SegmentationError: The labels are missing or do not fit the dataset.
    """

    def __init__(self, root: Path, config: BudsConfig) -> None:
        self.root = Path(root)
        dims = config.history_dims or []
        table = read_table(self.root, [STATE] if dims else [])
        self.starts, self.ends, self.present = table.starts, table.ends, table.present
        total = len(self.present)
        if config.skills == "segments":
            _, self.skill, self.subgoal = load_labels(self.root)
        else:
            self.skill = np.where(self.present, 0, -1)
            self.subgoal = _ahead(table.starts, table.ends, total, config.subgoal_horizon)
        counts = np.bincount(self.skill[self.present], minlength=config.n_skills or 1)
        self.weights = torch.from_numpy(counts.sum() / (len(counts) * np.maximum(counts, 1)))
        self.ending = _ending(self.skill, table.starts, table.ends, config.meta_period)
        self.history_frames = config.history_frames
        state = table.columns[STATE].reshape(total, -1) if dims else np.empty((total, 0))
        self.history = state[:, dims].astype(np.float32)
        self.goals = GoalFrames(self.root, config, table.starts) if config.has_subgoals else None

    def lookup(self, index: Tensor) -> Supervision:
        """Collects the supervision of a batch.

        Args:
            index: ``(B,)`` int64 absolute frame indices.

        Returns:
            Tensors on the device of `index`.

        Raises:
            DatasetError: An index is outside the dataset.
            SegmentationError: A frame has no label, or its subgoal frame is not there.
        """
        rows = index.detach().cpu().numpy().astype(np.int64).reshape(-1)
        total = len(self.skill)
        if len(rows) and (rows.min() < 0 or rows.max() >= total):
            raise DatasetError(f"{self.root}: the batch holds frame {rows.max()}, the dataset has {total} frames.")
        goals = self.subgoal[rows]
        bad = (self.skill[rows] < 0) | (goals < 0) | (goals >= total)
        bad |= ~self.present[np.where(bad, 0, goals)]
        if bad.any():
            frame = int(rows[bad][0])
            raise SegmentationError(
                f"{self.root}: frame {frame} has no skill label or its subgoal frame is not on this machine. Download "
                "the whole dataset, or run lerobot-buds-segment again."
            )
        starts = self.starts[np.searchsorted(self.ends, rows, side="right")]
        history = self.history[history_rows(rows, starts, self.history_frames)]
        device = index.device
        return Supervision(
            skill=torch.from_numpy(self.skill[rows]).to(device),
            subgoal=torch.from_numpy(goals),
            ending=torch.from_numpy(self.ending[rows]).to(device),
            history=torch.from_numpy(history).to(device),
        )


def _ahead(starts: IntArray, ends: IntArray, total: int, horizon: int) -> IntArray:
    """Takes whole demonstrations for segments: absolute subgoal of every frame, -1 outside all of them."""
    subgoal = np.full(total, -1, dtype=np.int64)
    for start, end in zip(starts, ends, strict=True):
        subgoal[start:end] = start + subgoals_of(np.zeros(end - start, dtype=np.int64), horizon)
    return subgoal


def _ending(skill: IntArray, starts: IntArray, ends: IntArray, period: int) -> NDArray[np.bool_]:
    """Marks the last `period` frames of every segment."""
    marks = np.zeros(len(skill), dtype=np.bool_)
    for start, end in zip(starts, ends, strict=True):
        for segment in segments_of(skill[start:end]):
            last = int(start) + segment.end
            marks[max(int(start) + segment.start, last - period) : last] = True
    return marks
