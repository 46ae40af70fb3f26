"""The skill library: K goal-conditioned policies that share nothing, each with its own subgoal space."""

from collections.abc import Callable
from typing import cast

import torch
from torch import Tensor, nn

from .configuration_buds import BudsConfig
from .encoders import make_conv_trunk, make_keypoint_encoder, make_mlp, make_resnet_trunk


class SkillPolicy(nn.Module):
    """One skill: image encoder, subgoal encoder and head (paper, section on skills; 14.19 M parameters at its sizes).

    Args:
        config: A configuration whose features and dimensions are settled.
    """

    def __init__(self, config: BudsConfig) -> None:
        super().__init__()
        image_channels = sum(feature.shape[0] for feature in config.image_features.values())
        goal_channels = config.image_features[config.cameras[0]].shape[0]
        if config.encoder == "resnet18":
            image_trunk = make_resnet_trunk(image_channels, config.norm, stages=4)
            goal_trunk = make_resnet_trunk(goal_channels, config.norm, stages=3)
        else:
            image_trunk = make_conv_trunk(image_channels, config.norm, config.conv_channels)
            goal_trunk = make_conv_trunk(goal_channels, config.norm, config.conv_channels)
        self.image_encoder = make_keypoint_encoder(*image_trunk, config.keypoints, config.image_feature)
        self.subgoal_encoder = make_keypoint_encoder(*goal_trunk, config.keypoints, config.subgoal_dim)
        inputs = config.image_feature + config.subgoal_dim + config.proprio_size
        self.head = make_mlp([inputs, *config.head_widths, config.action_feature.shape[0]])

    def forward(self, images: Tensor, subgoal: Tensor, proprio: Tensor) -> Tensor:
        """Computes actions.

        Args:
            images: ``(B, C, H, W)`` all cameras stacked, in [0, 1].
            subgoal: ``(B, subgoal_dim)`` of this skill's own subgoal space.
            proprio: ``(B, P)`` standardised proprioception.

        Returns:
            ``(B, A)`` actions in [-1, 1].
        """
        features = torch.cat([self.image_encoder(images), subgoal, proprio], dim=1)
        return torch.tanh(self.head(features))


class SkillLibrary(nn.Module):
    """The K skills; every row of a batch is run by the skill that its id names.

    Args:
        config: A configuration whose features and dimensions are settled.
    """

    def __init__(self, config: BudsConfig) -> None:
        super().__init__()
        self.skills = nn.ModuleList(SkillPolicy(config) for _ in range(config.n_skills or 1))
        self.uses_batch_statistics = config.norm == "batch"

    def forward(self, skill: Tensor, images: Tensor, subgoal: Tensor, proprio: Tensor) -> Tensor:
        """Computes actions ``(B, A)``; `skill` is ``(B,)`` int64, the rest as in `SkillPolicy.forward`."""
        return self._by_skill(skill, lambda k, rows: self._skill(k)(images[rows], subgoal[rows], proprio[rows]))

    def encode_subgoals(self, skill: Tensor, goals: Tensor) -> Tensor:
        """Encodes goal images ``(B, C, H, W)`` in [0, 1] into ``(B, subgoal_dim)``, row by row in its skill's space."""
        return self._by_skill(skill, lambda k, rows: self._skill(k).subgoal_encoder(goals[rows]))

    @torch.no_grad()
    def subgoal_targets(self, skill: Tensor, goals: Tensor) -> Tensor:
        """Encodes goal images without gradient, noise or batch statistics (the released code kept train mode).

        Args:
            skill: ``(B,)`` int64 skill of every row.
            goals: ``(B, C, H, W)`` in [0, 1], not augmented.
        """
        training = self.training
        self.eval()
        targets = self.encode_subgoals(skill, goals)
        self.train(training)
        return targets

    def _skill(self, k: int) -> SkillPolicy:
        return cast(SkillPolicy, self.skills[k])

    def _by_skill(self, skill: Tensor, compute: Callable[[int, Tensor], Tensor]) -> Tensor:
        order = torch.argsort(skill, stable=True)
        ids, counts = torch.unique_consecutive(skill[order], return_counts=True)
        groups = torch.split(order, counts.tolist())
        parts = [compute(k, rows) for k, rows in zip(ids.tolist(), groups, strict=True)]
        return torch.cat(parts)[torch.argsort(order)]
