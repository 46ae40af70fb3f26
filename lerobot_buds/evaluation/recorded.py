"""Frames of a dataset as a policy's model takes them, out of memory; LeRobot's loader would be most of the time."""

import numpy as np
import torch
from lerobot.datasets import LeRobotDatasetMetadata
from numpy.typing import NDArray
from torch import Tensor

from lerobot_buds.core import ACTION, STATE, IntArray
from lerobot_buds.data import (
    AnyDataset,
    FrameTable,
    LocalDataset,
    as_floats,
    cached_frames,
    read_table,
    require_videos,
    require_whole,
)
from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.fitting import task_number
from lerobot_buds.policy.inputs import Observation
from lerobot_buds.policy.labels import Labels, LabelTable
from lerobot_buds.policy.modeling_buds import BudsPolicy


class RecordedFrames:
    """All frames of the chosen episodes of a dataset.

    Args:
        dataset: What stands for it.
        policy: A policy that was built for it.

    Attributes:
        starts: ``(E,)`` int64 first frame of every chosen episode.
        ends: ``(E,)`` int64 one past its last frame.
        label_table: What the dataset says about its frames; the policy's own, which may have encoded them all.

    Raises:
        CheckpointError: A task is unknown to the policy.
        DatasetError: The dataset is damaged, or chosen episodes are not whole on this machine.
        SegmentationError: It is not segmented.
    """

    def __init__(self, dataset: AnyDataset, policy: BudsPolicy) -> None:
        dataset, config = LocalDataset.of(dataset), policy.config
        table = read_table(dataset, [*([STATE] if config.state_size else []), ACTION, "task_index"])
        total = len(table.present)
        self.starts, self.ends = table.starts, table.ends
        self._device, self._chunk = torch.device(str(config.device)), config.chunk_size
        self._cameras = [cached_frames(dataset, camera, size=config.image_shape) for camera in config.stacked_cameras]
        self._state = table.columns.get(STATE, np.empty((total, 0))).reshape(total, -1).astype(np.float32)
        self._actions = table.columns[ACTION].reshape(total, -1).astype(np.float32)
        require_whole(table)
        require_videos(dataset)
        self._tasks = _task_numbers(dataset, config, table)
        labels = policy.labels
        if labels is None or labels.root.resolve() != dataset.root.resolve():
            labels = LabelTable(dataset.root, config)
        self.label_table = labels
        self._workspace = config.stacked_cameras[0]

    def observation(self, rows: IntArray) -> Observation:
        """What was seen and felt in frames ``(B,)``."""
        images = np.concatenate([frames[rows] for frames in self._cameras], axis=1)
        return Observation(
            images=as_floats(torch.from_numpy(images).to(self._device)),
            state=torch.from_numpy(self._state[rows]).to(self._device),
            task=torch.from_numpy(self._tasks[rows]).to(self._device),
        )

    def actions(self, rows: IntArray) -> tuple[Tensor, Tensor]:
        """What was done from frames ``(B,)`` on: ``(B, n, A)`` actions, and ``(B, n)`` bool, after the end."""
        ahead = rows[:, None] + np.arange(self._chunk)
        last = self.ends[np.searchsorted(self.ends, rows, side="right")][:, None] - 1
        actions: NDArray[np.float32] = self._actions[np.minimum(ahead, last)]
        return torch.from_numpy(actions).to(self._device), torch.from_numpy(ahead > last).to(self._device)

    def labels(self, rows: IntArray) -> Labels:
        """What the dataset says about frames ``(B,)``."""
        images = {self._workspace: torch.from_numpy(self._cameras[0][rows])}
        found = self.label_table.lookup(torch.from_numpy(rows), images)
        return Labels(**{name: value.to(self._device) for name, value in vars(found).items()})


def _task_numbers(dataset: LocalDataset, config: BudsConfig, table: FrameTable) -> IntArray:
    """Looks up every frame's task among those of the policy, ``(N,)``; an episode may have several."""
    tasks = LeRobotDatasetMetadata(dataset.root.name, root=dataset.root).tasks
    names = {int(number): str(task) for task, number in tasks["task_index"].items()}
    column = table.columns["task_index"].reshape(-1).astype(np.int64)
    numbers = np.zeros(len(column), dtype=np.int64)
    for number in np.unique(column[table.present]):
        numbers[column == number] = task_number(config, names[int(number)])
    return numbers
