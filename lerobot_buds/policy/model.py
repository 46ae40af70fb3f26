"""The networks of policy type ``buds`` and their losses: see and feel, decide, act."""

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_buds.data import as_floats

from .actions import ActionCoding, ActionRange
from .configuration_buds import BudsConfig
from .inputs import Observation
from .labels import Labels, LabelTable
from .meta_controller import MetaControllers, Situation, SkillMemory
from .networks import random_shift
from .proprioception import CONSTANT_BELOW, Proprioception
from .skills import SkillLibrary

BESIDE_SHARE = 0.4
"""Share of the frames beside an edge that are trained with the skill of the other side (ours, measured)."""


class LatentGoals(nn.Module):
    """Standardises latents of goal frames; one space for all skills (ours).

    Args:
        width: Dimensions of a latent.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, width: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(width))
        self.register_buffer("std", torch.ones(width))

    def fit(self, latents: Tensor) -> None:
        """Takes mean and deviation of ``(N, d)`` latents; rows of NaN are frames that are not on this machine."""
        present = latents[~latents.isnan().any(dim=1)].double()
        self.mean.copy_(present.mean(dim=0))
        std = present.std(dim=0, correction=0)
        self.std.copy_(torch.where(std < CONSTANT_BELOW, torch.ones_like(std), std))

    def forward(self, latents: Tensor) -> Tensor:
        """Standardises ``(B, d)`` latents."""
        return (latents - self.mean) / self.std


class BudsModel(nn.Module):
    """Skills that pursue subgoals, and the meta controllers that pick skill and subgoal (paper).

    Both are trained together: the meta controllers' targets are the present outputs of the subgoal encoders, without
    gradient, so that they follow them. The released code trains the skills first.

    Args:
        config: A configuration that is completed.
        found: The actions of the dataset; None where weights will be loaded.
        dataset_stats: LeRobot's statistics; the same.
        labels: Labels of the dataset; the same.
    """

    def __init__(
        self,
        config: BudsConfig,
        found: ActionRange | None,
        dataset_stats: dict[str, dict[str, Any]] | None,
        labels: LabelTable | None,
    ) -> None:
        super().__init__()
        self.config = config
        n_skills = config.n_skills or 1
        self.actions = ActionCoding(config, found)
        self.proprioception = Proprioception(config, dataset_stats)
        self.skills = SkillLibrary(config)
        is_latent = config.has_subgoals and config.subgoal_space == "latent"
        self.goals = LatentGoals(config.subgoal_dim) if is_latent else None
        if self.goals is not None and labels is not None:
            self.goals.fit(torch.from_numpy(labels.latents))
        self.meta_controllers: MetaControllers | None = None
        if config.has_subgoals:
            shortest, longest = torch.zeros(n_skills), torch.ones(n_skills)
            if labels is not None:
                shortest, longest = torch.from_numpy(labels.shortest), torch.from_numpy(labels.longest)
            self.memory = SkillMemory(config, shortest.float(), longest.float())
            self.meta_controllers = MetaControllers(config, self.memory.width, self.skills.map_channels)

    def forward(
        self, observation: Observation, labels: Labels, actions: Tensor, is_padding: Tensor | None
    ) -> dict[str, Tensor]:
        """Computes the terms of the loss, and what they would come to in a rollout.

        Args:
            observation: What is seen and felt.
            labels: What the dataset says about these frames.
            actions: ``(B, n, A)`` demonstrated actions.
            is_padding: ``(B, n)`` bool, those after the end of the demonstration; None without any.

        Returns:
            ``(B,)`` floats by their names: those of `LOSSES` are trained on, and absent where their part is frozen.
        """
        if self.training:
            images = random_shift(observation.images, self.config.crop_padding)
            observation = Observation(images, observation.state, observation.task)
        skill, goal = self._drawn_beside_edges(labels)
        acting = skill
        maps, proprio = self.encode(observation, labels.history)
        terms: dict[str, Tensor] = {}
        subgoal = imagined = proprio[:, :0]
        if self.meta_controllers is not None:
            subgoal, target = self.encode_goals(skill, goal)
            acting = self._drawn_at_random(skill)
            if self.skills.encodes_goals and acting is not skill:
                subgoal, _ = self.encode_goals(acting, goal)
            situation = self.situation(observation, maps, proprio, labels.held, labels.held_for, labels.finished)
            losses, imagined = self.meta_controllers.losses(situation, skill, target, acting)
            terms |= vars(losses) | {"subgoal_spread": spread_within(target, skill, self.config.n_skills or 1)}
        if self.config.skills_path is None or not self.training:
            outputs = self.skills(
                acting, maps, self._as_in_rollouts(subgoal, imagined), self._told(proprio, observation)
            )
            errors, misses = self.actions.errors(outputs, actions), self.actions.misses(outputs, actions)  # (B, n)
            inside = torch.ones_like(errors) if is_padding is None else (~is_padding).to(errors)
            terms["skill_loss"] = labels.weight * (errors * inside).sum(dim=1) / inside.sum(dim=1)
            terms["action_error"] = (misses * inside).sum(dim=1) / inside.sum(dim=1)
        return terms

    def encode(self, observation: Observation, history: Tensor) -> tuple[Tensor, Tensor]:
        """Computes what skills and meta controllers start from.

        Args:
            observation: What is seen and felt.
            history: ``(B, n, h)`` raw gripper readings, oldest first, without the current one.

        Returns:
            Maps of the shared trunk, or the images where there is none, and ``(B, P)`` standardised proprioception.
        """
        return self.skills.encode_images(observation.images), self.proprioception(observation.state, history)

    def encode_goals(self, skill: Tensor, goal: Tensor) -> tuple[Tensor, Tensor]:
        """Turns goals into subgoals, ``(B, d)`` each: for the skills, and for the meta controllers, without gradient.

        Args:
            skill: ``(B,)`` int64.
            goal: As in `Labels`.
        """
        if self.goals is not None:
            subgoal: Tensor = self.goals(goal)
            return subgoal, subgoal
        images = as_floats(goal)
        subgoal = self.skills.encode_goals(skill, images)
        if self.training and self.skills.uses_batch_statistics:
            return subgoal, self.skills.subgoal_targets(skill, images)
        return subgoal, subgoal.detach()

    def situation(
        self, observation: Observation, maps: Tensor, proprio: Tensor, held: Tensor, held_for: Tensor, finished: Tensor
    ) -> Situation:
        """Collects what decisions are made from; for the last three arguments see `Labels`."""
        config = self.config
        remembers = torch.ones(len(held), 1, dtype=torch.bool, device=held.device)
        if self.training:
            remembers = torch.rand(len(held), 1, device=held.device) >= config.memory_dropout
        return Situation(
            images=maps if config.meta_trunk == "skills" else observation.images[:, : config.meta_channels],
            proprio=proprio if config.meta_proprioception else proprio[:, :0],
            memory=self.memory(held, held_for, finished),
            remembers=remembers,
            task=observation.task,
        )

    def decide(self, situation: Situation, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Picks skills ``(B,)`` and subgoals ``(B, d)``; `noise` is ``(B, latent)``."""
        assert self.meta_controllers is not None
        feature, logits = self.meta_controllers.propose(situation)
        skill = logits.argmax(dim=1)
        return skill, self.meta_controllers.imagine(feature, situation.task, skill, noise)

    def act(self, observation: Observation, maps: Tensor, proprio: Tensor, skill: Tensor, subgoal: Tensor) -> Tensor:
        """Computes the next actions ``(B, n, A)``, in the unit of the dataset."""
        outputs = self.skills(skill, maps, subgoal, self._told(proprio, observation))
        return self.actions.decode(self.actions.expected(outputs))

    def _told(self, proprio: Tensor, observation: Observation) -> Tensor:
        """Appends the task where no meta controller knows it."""
        if self.config.has_subgoals or not self.config.task_count:
            return proprio
        return torch.cat([proprio, F.one_hot(observation.task, self.config.task_count).to(proprio)], dim=1)

    def _drawn_beside_edges(self, labels: Labels) -> tuple[Tensor, Tensor]:
        """Takes the skill of the other side for some frames beside an edge: decisions come early and late."""
        if not self.training or self.meta_controllers is None:
            return labels.skill, labels.goal
        beside = torch.rand(len(labels.skill), device=labels.skill.device) < BESIDE_SHARE
        shape = (-1, *(1,) * (labels.goal.ndim - 1))
        goal = torch.where(beside.view(shape), labels.neighbour_goal, labels.goal)
        return torch.where(beside, labels.neighbour, labels.skill), goal

    def _drawn_at_random(self, skill: Tensor) -> Tensor:
        """Lets any skill act at some frames: one that was chosen wrongly then does what is right nevertheless."""
        if not self.training or not self.config.skill_dropout:
            return skill
        replaced = torch.rand(len(skill), device=skill.device) < self.config.skill_dropout
        return torch.where(replaced, torch.randint_like(skill, self.config.n_skills or 1), skill)

    def _as_in_rollouts(self, subgoal: Tensor, imagined: Tensor) -> Tensor:
        """Disturbs subgoals in training: some rows get what the meta controllers imagine, all get noise."""
        if not self.training or self.meta_controllers is None:
            return subgoal
        if self.config.imagined_subgoals:
            replaced = torch.rand(len(subgoal), 1, device=subgoal.device) < self.config.imagined_subgoals
            subgoal = torch.where(replaced, imagined.to(subgoal), subgoal)
        return subgoal + self.config.subgoal_noise * torch.randn_like(subgoal)


def spread_within(subgoal: Tensor, skill: Tensor, n_skills: int) -> Tensor:
    """Computes every subgoal's squared distance to the mean of its skill in the batch, ``(B,)``: what there is to say.

    Args:
        subgoal: ``(B, d)``.
        skill: ``(B,)`` int64.
        n_skills: Number of skills.
    """
    sums = subgoal.new_zeros(n_skills, subgoal.shape[1]).index_add(0, skill, subgoal)
    counts = torch.bincount(skill, minlength=n_skills).clamp(min=1)
    return (subgoal - (sums / counts[:, None])[skill]).float().square().sum(dim=1)
