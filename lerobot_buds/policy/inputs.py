"""Takes LeRobot's batches apart: shapes compared, ranks restored, numbers as floats, one task for every row.

LeRobot hands features of one number over as scalars, ``(B,)`` where others are ``(B, D)``; its processor then takes the
rows for the numbers of a single row, ``(1, B)``. Columns keep the type in which they were recorded. Behind this module
there are only floats of the rank that the networks expect.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from lerobot_buds.core import ACTION, STATE, CheckpointError
from lerobot_buds.data import scale_images

from .configuration_buds import BudsConfig
from .fitting import task_number


@dataclass(frozen=True)
class Observation:
    """What is seen and felt.

    Attributes:
        images: ``(B, C, H, W)`` of network size, all cameras stacked, in [0, 1].
        state: ``(B, D)`` raw state, D = 0 without one.
        task: ``(B,)`` int64 numbers of the tasks.
    """

    images: Tensor
    state: Tensor
    task: Tensor

    def __getitem__(self, rows: Tensor) -> "Observation":
        """Picks some rows."""
        return Observation(self.images[rows], self.state[rows], self.task[rows])


def read_inputs(config: BudsConfig, batch: Mapping[str, Any]) -> Observation:
    """Checks the inputs of a batch.

    Args:
        config: Settled settings of the policy.
        batch: LeRobot's batch.

    Raises:
        CheckpointError: An input is missing or has another shape than the policy was made for.
        ConfigError: A task is unknown.
    """
    missing = [key for key in config.input_features if key not in batch]
    if missing:
        known = sorted(key for key in batch if key.startswith("observation"))
        raise CheckpointError(f"The policy needs {missing}, which the observation lacks. It has {known}.")
    count = _count(config, batch)
    values = {}
    for key, feature in config.input_features.items():
        value, expected = batch[key], tuple(feature.shape)
        if expected == (1,) and value.shape in _ranks_of_one(count):
            value = value.reshape(count, 1)
        if tuple(value.shape[1:]) != expected:
            given = tuple(value.shape[1:])
            raise CheckpointError(f"{key}: the policy was made for shape {expected}, the observation has {given}.")
        if len(value) != count:
            raise CheckpointError(f"{key} has {len(value)} rows, the images of the same observation have {count}.")
        is_bytes = key in config.image_features and value.dtype == torch.uint8
        values[key] = value.float() / 255 if is_bytes else value.float()
    images = torch.cat([scale_images(values[key], config.image_shape) for key in config.stacked_cameras], dim=1)
    images = images.contiguous(memory_format=torch.channels_last)  # which convolutions are faster on
    state = values[STATE] if STATE in values else images.new_zeros(len(images), 0)
    tasks = [task_number(config, task) for task in _tasks(batch, count)]
    return Observation(images, state, torch.tensor(tasks).to(images.device, non_blocking=True))


def read_actions(config: BudsConfig, batch: Mapping[str, Any]) -> Tensor:
    """Checks the demonstrated actions of a batch.

    Args:
        config: Settled settings of the policy.
        batch: LeRobot's batch; ``action`` is ``(B, A)``, or ``(B, n, A)`` with chunks of n actions, and without the
            last dimension where A is 1.

    Returns:
        ``(B, n, A)`` float32, in the dataset's unit.

    Raises:
        CheckpointError: There are none, or they have another shape.
    """
    if ACTION not in batch:
        raise CheckpointError(f"The batch holds no {ACTION!r}, which a loss needs. It has {sorted(batch)}.")
    actions: Tensor = batch[ACTION]
    count, chunk, size = _count(config, batch), config.chunk_size, int(config.action_feature.shape[0])
    if size == 1 and actions.shape in ([(count, chunk)] if chunk > 1 else _ranks_of_one(count)):
        actions = actions.reshape(count, chunk, 1)
    elif chunk == 1 and actions.ndim == 2:
        actions = actions[:, None]
    if tuple(actions.shape) != (count, chunk, size):
        raise CheckpointError(
            f"{ACTION}: the policy was made for {chunk} action(s) of {size} number(s) at once, the batch has shape "
            f"{tuple(batch[ACTION].shape)}."
        )
    return actions.float()


def _count(config: BudsConfig, batch: Mapping[str, Any]) -> int:
    return len(batch[config.stacked_cameras[0]])


def _ranks_of_one(count: int) -> list[tuple[int, ...]]:
    """Lists the shapes in which one number a row may come."""
    return [(count,), (1, count), (count, 1)]


def _tasks(batch: Mapping[str, Any], count: int) -> list[str]:
    given = batch.get("task") or ""
    tasks = [given] * count if isinstance(given, str) else list(given)
    if len(tasks) != count:
        raise CheckpointError(f"The batch has {len(tasks)} tasks for {count} rows: {tasks}.")
    return tasks
