"""The networks of policy type ``buds`` and their losses: see and feel, decide, act."""

from dataclasses import dataclass, replace
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_buds.data import as_floats

from .actions import ActionCoding, ActionRange
from .configuration_buds import BudsConfig
from .grouping import Grouping
from .inputs import Observation
from .labels import Labels, LabelTable
from .meta_controller import MetaControllers, Situation, SkillMemory
from .networks import random_shift
from .proprioception import CONSTANT_BELOW, Proprioception
from .skills import SkillLibrary

BESIDE_SHARE = 0.4
"""Share of the frames beside an edge that are trained with the skill of the other side (ours)."""


@dataclass(frozen=True)
class Percept:
    """What skills and meta controllers start from.

    Attributes:
        images: ``(B, C, H, W)`` in [0, 1].
        maps: Maps of the skills' shared trunk; the images where there is none.
        proprio: ``(B, P)`` standardised proprioception.
        told: The same, and the task where no meta controller knows it.
        task: ``(B,)`` int64 numbers of the tasks.
    """

    images: Tensor
    maps: Tensor
    proprio: Tensor
    told: Tensor
    task: Tensor

    def __getitem__(self, rows: Tensor) -> "Percept":
        """Picks some rows."""
        return Percept(*(value[rows] for value in vars(self).values()))


@dataclass(frozen=True)
class Sample:
    """The frames of a batch as a loss takes them: images shifted, and skills drawn beside edges.

    Attributes:
        images: See `Observation`, as the next two.
        state: ``(B, D)``.
        task: ``(B,)``.
        skill: See `Labels`, as all up to `history`.
        goal: Goal of that skill.
        weight: ``(B,)``.
        held: ``(B,)``.
        held_for: ``(B,)``.
        finished: ``(B, K)``.
        history: ``(B, n, h)``.
        actions: ``(B, n, A)`` demonstrated actions.
        is_padding: ``(B, n)`` bool, those after the end of the demonstration.
    """

    images: Tensor
    state: Tensor
    task: Tensor
    skill: Tensor
    goal: Tensor
    weight: Tensor
    held: Tensor
    held_for: Tensor
    finished: Tensor
    history: Tensor
    actions: Tensor
    is_padding: Tensor

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        """All of it, in the order of the arguments."""
        return tuple(vars(self).values())

    @property
    def observation(self) -> Observation:
        """What is seen and felt."""
        return Observation(self.images, self.state, self.task)


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
            ``(B,)`` floats by their names, the same at every step; those of frozen skills are absent.
        """
        return self.terms(self.sample(observation, labels, actions, is_padding))

    def sample(self, observation: Observation, labels: Labels, actions: Tensor, is_padding: Tensor | None) -> Sample:
        """Draws what is drawn for the data's sake in training; for the arguments see `forward`."""
        if self.training:
            observation = replace(observation, images=random_shift(observation.images, self.config.crop_padding))
        skill, goal, weight = self._drawn_beside_edges(labels)
        if is_padding is None:
            is_padding = torch.zeros(actions.shape[:2], dtype=torch.bool, device=actions.device)
        past = labels.held, labels.held_for, labels.finished, labels.history
        seen = observation.images, observation.state, observation.task
        return Sample(*seen, skill, goal, weight, *past, actions, is_padding)

    def groupings(self, sample: Sample) -> tuple[Grouping, Grouping]:
        """Groups the rows of a sample by skills, and by meta controllers; here a step waits for a GPU."""
        controllers = self.meta_controllers
        by_task = controllers.grouping(sample.task) if controllers else Grouping.whole(len(sample.task))
        return self.skills.grouping(sample.skill), by_task

    def terms(self, sample: Sample, groupings: tuple[Grouping, Grouping] | None = None) -> dict[str, Tensor]:
        """Computes what `forward` returns, and waits for nothing.

        Args:
            sample: What `sample` returned.
            groupings: What `groupings` returned, or the same with rows that fill up.
        """
        by_skill, by_task = groupings or self.groupings(sample)
        percept = self.encode(sample.observation, sample.history)
        terms: dict[str, Tensor] = {}
        subgoal = percept.proprio[:, :0]
        if self.meta_controllers is not None:
            subgoal, target = self.encode_goals(by_skill, sample.goal)
            situation = self.situation(percept, sample.held, sample.held_for, sample.finished)
            losses, imagined = self.meta_controllers.losses(situation, sample.skill, target, by_task)
            terms |= vars(losses) | {"subgoal_spread": spread_within(target, sample.skill, self.config.n_skills or 1)}
            subgoal = self._as_in_rollouts(subgoal, imagined)
        if self.config.skills_path is None or not self.training:
            outputs = self.skills(by_skill, percept.maps, subgoal, percept.told)
            terms |= self._errors(outputs, sample)
        return terms

    def loss(self, terms: dict[str, Tensor], labels: Labels) -> Tensor:
        """Adds up what is trained on, ``(B,)``, of the terms that `forward` returned for these labels."""
        weights = {"skill_loss": 1.0, "skill_id_loss": 1.0, "subgoal_loss": 1.0, "kl_loss": self.config.kl_weight}
        trained = torch.stack([weights[name] * term for name, term in terms.items() if name in weights])
        return labels.frame_weight * trained.sum(dim=0)

    def encode(self, observation: Observation, history: Tensor) -> Percept:
        """Computes what skills and meta controllers start from.

        Args:
            observation: What is seen and felt.
            history: ``(B, n, h)`` raw gripper readings, oldest first, without the current one.
        """
        maps = self.skills.encode_images(observation.images)
        told = proprio = self.proprioception(observation.state, history)
        if self.config.task_count and not self.config.has_subgoals:
            told = torch.cat([proprio, F.one_hot(observation.task, self.config.task_count).to(proprio)], dim=1)
        return Percept(observation.images, maps, proprio, told, observation.task)

    def encode_goals(self, skill: Tensor | Grouping, goal: Tensor) -> tuple[Tensor, Tensor]:
        """Turns goals into subgoals, ``(B, d)`` each: for the skills, and for the meta controllers, without gradient.

        Args:
            skill: ``(B,)`` int64, or rows that have been grouped by it.
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

    def situation(self, percept: Percept, held: Tensor, held_for: Tensor, finished: Tensor) -> Situation:
        """Collects what decisions are made from; for the last three arguments see `Labels`."""
        config = self.config
        remembers = torch.ones(len(held), 1, dtype=torch.bool, device=held.device)
        if self.training:
            remembers = torch.rand(len(held), 1, device=held.device) >= config.memory_dropout
        return Situation(
            images=percept.maps if config.meta_trunk == "skills" else percept.images[:, : config.meta_channels],
            proprio=percept.proprio if config.meta_proprioception else percept.proprio[:, :0],
            memory=self.memory(held, held_for, finished),
            remembers=remembers,
            task=percept.task,
        )

    def decide(self, situation: Situation, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Picks skills ``(B,)`` and subgoals ``(B, d)``; `noise` is ``(B, latent)``."""
        assert self.meta_controllers is not None
        feature, logits = self.meta_controllers.propose(situation)
        skill = logits.argmax(dim=1)
        return skill, self.meta_controllers.imagine(feature, situation.task, skill, noise)

    def act(self, percept: Percept, skill: Tensor, subgoal: Tensor) -> Tensor:
        """Computes the next actions ``(B, n, A)``, in the unit of the dataset."""
        outputs = self.skills(skill, percept.maps, subgoal, percept.told)
        return self.actions.decode(self.actions.expected(outputs))

    def _errors(self, outputs: Tensor, sample: Sample) -> dict[str, Tensor]:
        """Compares outputs with demonstrated actions, ``(B,)`` means over those of the demonstration."""
        errors = self.actions.errors(outputs, sample.actions)  # (B, n)
        misses = self.actions.misses(outputs, sample.actions)  # (B, n)
        inside = (~sample.is_padding).to(errors)
        count = inside.sum(dim=1)
        return {
            "skill_loss": sample.weight * (errors * inside).sum(dim=1) / count,
            "action_error": (misses * inside).sum(dim=1) / count,
        }

    def _drawn_beside_edges(self, labels: Labels) -> tuple[Tensor, Tensor, Tensor]:
        """Takes the skill of the other side for some frames beside an edge: decisions come early and late."""
        if not self.training or self.meta_controllers is None:
            return labels.skill, labels.goal, labels.weight
        beside = torch.rand(len(labels.skill), device=labels.skill.device) < BESIDE_SHARE
        shape = (-1, *(1,) * (labels.goal.ndim - 1))
        goal = torch.where(beside.view(shape), labels.neighbour_goal, labels.goal)
        weight = torch.where(beside, labels.neighbour_weight, labels.weight)
        return torch.where(beside, labels.neighbour, labels.skill), goal, weight

    def _as_in_rollouts(self, subgoal: Tensor, imagined: Tensor) -> Tensor:
        """Disturbs subgoals in training: some rows get what the meta controllers imagine, all get noise."""
        if not self.training:
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
    counts = F.one_hot(skill, n_skills).sum(dim=0).clamp(min=1)  # `bincount` would wait for a GPU
    return (subgoal - (sums / counts[:, None])[skill]).float().square().sum(dim=1)
