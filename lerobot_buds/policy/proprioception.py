"""What the skills feel: the current joints and the gripper readings of a short past, standardised."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from lerobot_buds.core import STATE

from .configuration_buds import BudsConfig

CONSTANT_BELOW = 1e-6
"""Standard deviation under which a dimension counts as constant and is centred only."""


class Proprioception(nn.Module):
    """Selects and standardises dimensions of the state (paper: joints at t, gripper at t-5, ..., t-1; scaling ours).

    Mean and standard deviation are buffers: they are saved with the weights, so that a trained skill keeps its scaling
    when a checkpoint is trained further on other data.

    Args:
        config: A configuration whose dimensions are settled.
        dataset_stats: LeRobot's statistics; without them (a checkpoint will be loaded) the state is not changed.
    """

    mean: Tensor
    std: Tensor
    current_dims: Tensor
    history_dims: Tensor

    def __init__(self, config: BudsConfig, dataset_stats: Mapping[str, Mapping[str, Any]] | None) -> None:
        super().__init__()
        for name in ("current_dims", "history_dims"):  # on the device: what picks by a list waits for a GPU
            dims = torch.tensor(getattr(config, name) or [], dtype=torch.int64)
            self.register_buffer(name, dims, persistent=False)
        mean, std = torch.zeros(config.state_size), torch.ones(config.state_size)
        if dataset_stats and STATE in dataset_stats and config.state_size:
            mean = torch.as_tensor(dataset_stats[STATE]["mean"], dtype=torch.float32).reshape(-1)
            std = torch.as_tensor(dataset_stats[STATE]["std"], dtype=torch.float32).reshape(-1)
            std = torch.where(std < CONSTANT_BELOW, torch.ones_like(std), std)
        self.register_buffer("mean", mean.clone())
        self.register_buffer("std", std.clone())

    def reading(self, state: Tensor) -> Tensor:
        """Selects the dimensions that are remembered: ``(B, D)`` raw state to ``(B, h)`` raw reading."""
        return state[:, self.history_dims]

    def forward(self, state: Tensor, history: Tensor) -> Tensor:
        """Builds the proprioception of the skills.

        Args:
            state: ``(B, D)`` raw state.
            history: ``(B, n, h)`` raw readings, oldest first, without the current one.

        Returns:
            ``(B, c + n h)`` standardised numbers: the current dimensions, then the readings in time order.
        """
        current = ((state - self.mean) / self.std)[:, self.current_dims]
        past = (history - self.mean[self.history_dims]) / self.std[self.history_dims]
        return torch.cat([current, past.flatten(start_dim=1)], dim=1)
