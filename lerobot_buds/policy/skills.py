"""The skill library: K goal-conditioned policies that share nothing, each with its own subgoal space."""

from typing import cast

import torch
from torch import Tensor, nn

from .configuration_buds import BudsConfig
from .encoders import Trunk, make_keypoint_encoder, make_mlp, make_trunk
from .groups import Rows, by_group


class SkillPolicy(nn.Module):
    """One skill: image encoder, subgoal encoder and head (paper, section on skills; 14.19 M parameters at its sizes).

    Args:
        config: A configuration whose features and dimensions are settled.
        image_trunk: Trunk of the image encoder, with the channels of its maps.
        goal_trunk: Trunk of the subgoal encoder; None for a skill without subgoals.
    """

    def __init__(self, config: BudsConfig, image_trunk: Trunk, goal_trunk: Trunk | None) -> None:
        super().__init__()
        self.image_encoder = make_keypoint_encoder(*image_trunk, config.keypoints, config.image_feature)
        subgoal = 0
        if goal_trunk is not None:
            self.subgoal_encoder = make_keypoint_encoder(*goal_trunk, config.keypoints, config.subgoal_dim)
            subgoal = config.subgoal_dim
        self.chunk = config.chunk_size, config.action_feature.shape[0]
        self.termination = config.termination
        inputs = config.image_feature + subgoal + config.proprio_size
        outputs = self.chunk[0] * self.chunk[1] + self.termination
        self.head = make_mlp([inputs, *config.head_widths, outputs])

    def forward(self, images: Tensor, subgoal: Tensor, proprio: Tensor) -> tuple[Tensor, Tensor]:
        """Computes what `ActionCoding` makes actions of.

        Args:
            images: ``(B, C, H, W)`` all cameras stacked, in [0, 1], or maps of the trunk where that is shared.
            subgoal: ``(B, subgoal_dim)`` of this skill's own subgoal space; ``(B, 0)`` for a skill without subgoals.
            proprio: ``(B, P)`` standardised proprioception.

        Returns:
            ``(B, n, A)`` outputs for the next n actions, and ``(B,)`` the logits that the skill is about to end, all
            0 where that is not learned.
        """
        output = self.head(torch.cat([self.image_encoder(images), subgoal, proprio], dim=1))
        ending = output[:, -1] if self.termination else output.new_zeros(len(output))
        return output[:, : self.chunk[0] * self.chunk[1]].reshape(-1, *self.chunk), ending


class SkillLibrary(nn.Module):
    """The K skills; every row of a batch is run by the skill that its id names.

    Args:
        config: A configuration whose features and dimensions are settled.
    """

    def __init__(self, config: BudsConfig) -> None:
        super().__init__()
        image_channels = sum(feature.shape[0] for feature in config.image_features.values())
        goal_channels = config.image_features[config.stacked_cameras[0]].shape[0]
        self.image_trunk: nn.Module = nn.Identity()
        self.goal_trunk: nn.Module = nn.Identity()

        def trunks() -> tuple[Trunk, Trunk | None]:
            image_trunk = make_trunk(config, image_channels, stages=4)
            return image_trunk, make_trunk(config, goal_channels, stages=3) if config.has_subgoals else None

        if config.shared_trunk:
            image, goal = trunks()
            self.image_trunk, self.goal_trunk = image[0], goal[0] if goal else nn.Identity()
            of_skill = (nn.Identity(), image[1]), (nn.Identity(), goal[1]) if goal else None
            skills = [SkillPolicy(config, *of_skill) for _ in range(config.n_skills or 1)]
        else:
            skills = [SkillPolicy(config, *trunks()) for _ in range(config.n_skills or 1)]
        self.skills = nn.ModuleList(skills)
        self.uses_batch_statistics = config.norm == "batch"

    def forward(self, skill: Tensor, images: Tensor, subgoal: Tensor, proprio: Tensor) -> tuple[Tensor, Tensor]:
        """Computes outputs ``(B, n, A)`` and logits of ending ``(B,)`` as `SkillPolicy`; `skill` is ``(B,)`` int64."""
        maps = self.image_trunk(images)

        def compute(k: int, rows: Rows) -> tuple[Tensor, Tensor]:
            result: tuple[Tensor, Tensor] = self._skill(k)(maps[rows], subgoal[rows], proprio[rows])
            return result

        outputs, ending = by_group(skill, compute)
        return outputs, ending

    def encode_subgoals(self, skill: Tensor, goals: Tensor) -> Tensor:
        """Encodes goal images ``(B, C, H, W)`` in [0, 1] into ``(B, subgoal_dim)``, row by row in its skill's space."""
        maps = self.goal_trunk(goals)
        (subgoals,) = by_group(skill, lambda k, rows: [self._skill(k).subgoal_encoder(maps[rows])])
        return subgoals

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
