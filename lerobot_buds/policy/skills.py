"""The skill library: K goal-conditioned policies, each with its own subgoal space unless goals are latents."""

from typing import cast

import torch
from torch import Tensor, nn

from .configuration_buds import BudsConfig
from .grouping import Grouping, by_group
from .networks import Trunk, make_keypoint_encoder, make_mlp, make_trunk


class SkillPolicy(nn.Module):
    """One skill: image encoder, subgoal encoder and head (paper, section on skills; 14.19 M parameters at its sizes).

    Args:
        config: A configuration that is completed.
        image_trunk: Trunk of the image encoder, with the channels of its maps.
        goal_trunk: Trunk of the subgoal encoder; None where goals are not encoded.
        subgoal_dim: Width of its subgoals; 0 without them.
    """

    def __init__(self, config: BudsConfig, image_trunk: Trunk, goal_trunk: Trunk | None, subgoal_dim: int) -> None:
        super().__init__()
        self.image_encoder = make_keypoint_encoder(*image_trunk, config.keypoints, config.image_feature)
        if goal_trunk is not None:
            self.subgoal_encoder = make_keypoint_encoder(*goal_trunk, config.keypoints, subgoal_dim)
        self.chunk = config.chunk_size, int(config.action_feature.shape[0])
        told = 0 if config.has_subgoals else config.task_count  # a meta controller knows the task, a flat policy must
        inputs = config.image_feature + subgoal_dim + config.proprio_size + told
        self.head = make_mlp([inputs, *config.head_widths, self.chunk[0] * self.chunk[1]])

    def forward(self, images: Tensor, subgoal: Tensor, proprio: Tensor) -> Tensor:
        """Computes what `ActionCoding` makes actions of.

        Args:
            images: ``(B, C, H, W)`` all cameras stacked, in [0, 1], or maps of the trunk where that is shared.
            subgoal: ``(B, d)``; ``(B, 0)`` for a skill without subgoals.
            proprio: ``(B, P)`` standardised proprioception, and one number for every task where the skill is told it.

        Returns:
            ``(B, n, A)`` outputs for the next n actions.
        """
        output: Tensor = self.head(torch.cat([self.image_encoder(images), subgoal, proprio], dim=1))
        return output.reshape(-1, *self.chunk)

    def start_at_zero(self) -> None:
        """Makes all outputs 0, until it is trained."""
        last = cast(nn.Linear, self.head[-1])
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)


class SkillLibrary(nn.Module):
    """The K skills; every row of a batch is run by the skill that its id names.

    Args:
        config: A configuration that is completed.
    """

    def __init__(self, config: BudsConfig) -> None:
        super().__init__()
        self._channels = sum(int(feature.shape[0]) for feature in config.image_features.values())
        self.encodes_goals = config.has_subgoals and config.subgoal_space == "image"
        self.subgoal_dim = config.subgoal_dim if config.has_subgoals else 0
        self.image_trunk: nn.Module = nn.Identity()
        self.goal_trunk: nn.Module = nn.Identity()
        self.map_channels = 0
        shared: tuple[Trunk, Trunk | None] | None = None
        if config.shared_trunk:
            image, goal = self._make_trunks(config)
            self.image_trunk, self.map_channels = image
            if goal is not None:
                self.goal_trunk = goal[0]
            shared = (nn.Identity(), image[1]), (nn.Identity(), goal[1]) if goal else None

        def make_skill() -> SkillPolicy:
            return SkillPolicy(config, *(shared or self._make_trunks(config)), self.subgoal_dim)

        self.skills = nn.ModuleList(make_skill() for _ in range(config.n_skills or 1))
        self.base: SkillPolicy | None = None
        if config.heads == "residual":
            trunk = shared[0] if shared else self._make_trunks(config)[0]
            self.base = SkillPolicy(config, trunk, None, subgoal_dim=0)
            for skill in self.skills:
                cast(SkillPolicy, skill).start_at_zero()
        self.uses_batch_statistics = config.norm == "batch"

    def grouping(self, skill: Tensor) -> Grouping:
        """Groups rows by their skills ``(B,)`` int64, which waits for a GPU where there are several."""
        return Grouping.of(skill) if len(self.skills) > 1 else Grouping.whole(len(skill))

    def forward(self, skill: Tensor | Grouping, maps: Tensor, subgoal: Tensor, proprio: Tensor) -> Tensor:
        """Computes outputs ``(B, n, A)`` as `SkillPolicy`.

        Args:
            skill: ``(B,)`` int64, or rows that have been grouped by it; so in all of these methods.
            maps: What `encode_images` returned.
            subgoal: ``(B, d)``.
            proprio: ``(B, P)``.
        """
        grouping = self._grouped(skill)
        (outputs,) = by_group(grouping, lambda k, rows: [self._act(k, maps[rows], subgoal[rows], proprio[rows])])
        if self.base is not None:
            outputs = outputs + self.base(maps, subgoal[:, :0], proprio)
        return outputs

    def encode_images(self, images: Tensor) -> Tensor:
        """Runs the shared trunk on images ``(B, C, H, W)`` in [0, 1]; without one they stay what they are."""
        maps: Tensor = self.image_trunk(images)
        return maps

    def encode_goals(self, skill: Tensor | Grouping, goals: Tensor) -> Tensor:
        """Encodes goal images ``(B, 3, H, W)`` in [0, 1] into ``(B, d)``, row by row in its skill's space."""
        maps = self.goal_trunk(goals)
        grouping = self._grouped(skill)
        (subgoals,) = by_group(grouping, lambda k, rows: [self._skill(k).subgoal_encoder(maps[rows])])
        return subgoals

    @torch.no_grad()
    def subgoal_targets(self, skill: Tensor | Grouping, goals: Tensor) -> Tensor:
        """Encodes goal images without gradient, noise or batch statistics (the released code kept train mode).

        Args:
            skill: ``(B,)`` int64 skill of every row.
            goals: ``(B, 3, H, W)`` in [0, 1], not augmented.
        """
        training = self.training
        self.eval()
        targets = self.encode_goals(skill, goals)
        self.train(training)
        return targets

    def _grouped(self, skill: Tensor | Grouping) -> Grouping:
        return skill if isinstance(skill, Grouping) else self.grouping(skill)

    def _make_trunks(self, config: BudsConfig) -> tuple[Trunk, Trunk | None]:
        image_trunk = make_trunk(config, self._channels, stages=4)
        return image_trunk, make_trunk(config, 3, stages=3) if self.encodes_goals else None

    def _act(self, k: int, maps: Tensor, subgoal: Tensor, proprio: Tensor) -> Tensor:
        output: Tensor = self._skill(k)(maps, subgoal, proprio)
        return output

    def _skill(self, k: int) -> SkillPolicy:
        return cast(SkillPolicy, self.skills[k])
