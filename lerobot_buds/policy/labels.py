"""Looks up what LeRobot's batch does not carry: skill, goal image and gripper history of frames, by absolute index.

LeRobot drops custom columns on the way to the policy, and always keeps ``index``. The tables are plain data of one
process, never parameters or buffers, which would be broadcast and saved with the weights.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from lerobot_buds.core import STATE, CheckpointError, DatasetError, IntArray, SegmentationError
from lerobot_buds.demos import cached_frames, read_table
from lerobot_buds.segmentation import load_labels


@dataclass(frozen=True)
class Supervision:
    """What the dataset says about the frames of a batch.

    Attributes:
        skill: ``(B,)`` int64 skill labels.
        goals: ``(B, 3, H, W)`` float32 workspace images at the subgoal frames, in [0, 1], stored size.
        history: ``(B, n, h)`` float32 gripper readings of the n frames before, oldest first.
    """

    skill: Tensor
    goals: Tensor
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
    """Labels, goal frames and gripper readings of one segmented dataset.

    Args:
        root: Folder of the segmented dataset.
        camera: Workspace camera.
        image_shape: Shape ``(3, H, W)`` of its images that the policy expects.
        history_dims: Dimensions of the state whose history the skills see.
        history_frames: Length of that history (frames).

    Raises:
        SegmentationError: The labels are missing or do not fit the dataset.
        CheckpointError: The images have another shape.
    """

    def __init__(
        self,
        root: Path,
        camera: str,
        image_shape: tuple[int, ...],
        history_dims: Sequence[int],
        history_frames: int,
    ) -> None:
        self.root = Path(root)
        _, self.skill, self.subgoal = load_labels(self.root)
        self.goals = cached_frames(self.root, camera)
        if self.goals.shape[1:] != image_shape:
            raise CheckpointError(
                f"{self.root}: {camera!r} has shape {self.goals.shape[1:]}, the policy was made for {image_shape}."
            )
        table = read_table(self.root, [STATE] if history_dims else [])
        self.starts, self.ends, self.present = table.starts, table.ends, table.present
        self.history_frames = history_frames
        total = len(self.skill)
        state = table.columns[STATE].reshape(total, -1) if history_dims else np.empty((total, 0))
        self.history = state[:, list(history_dims)].astype(np.float32)

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
            goals=torch.from_numpy(self.goals[goals]).to(device).float().div_(255),
            history=torch.from_numpy(history).to(device),
        )
