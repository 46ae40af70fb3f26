"""The meta controller: picks the skill from what is seen, felt and remembered, and imagines its subgoal (cVAE)."""

from dataclasses import dataclass
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .configuration_buds import BudsConfig
from .grouping import Grouping, Rows, by_group
from .networks import make_keypoint_encoder, make_mlp, make_pooled_encoder, make_trunk

MEMORY_WIDTH = 128
"""Hidden units of the network that reads the memory (ours)."""

MEMORY_SAY = 2.0
"""Most that the memory adds to a logit (ours): it settles what the eyes leave open, and does not overrule them."""


@dataclass(frozen=True)
class Situation:
    """What a decision is made from.

    Attributes:
        images: ``(B, C, H, W)`` in [0, 1], or maps of the skills' trunk.
        proprio: ``(B, P)`` standardised proprioception; ``(B, 0)`` where the meta controller does not feel.
        memory: ``(B, M)`` from `SkillMemory`; ``(B, 0)`` where it does not remember.
        remembers: ``(B, 1)`` bool, whether the memory counts.
        task: ``(B,)`` int64 numbers of the tasks.
    """

    images: Tensor
    proprio: Tensor
    memory: Tensor
    remembers: Tensor
    task: Tensor

    def __getitem__(self, rows: Tensor | slice) -> "Situation":
        """Picks some rows."""
        return Situation(*(value[rows] for value in vars(self).values()))


class SkillMemory(nn.Module):
    """Puts in numbers which skill is in force, for how long, and which had been done before it (ours).

    Args:
        config: A configuration that is completed.
        shortest: ``(K,)`` frames of every skill's shortest segment.
        longest: ``(K,)`` frames of its longest.
    """

    shortest: Tensor
    longest: Tensor

    def __init__(self, config: BudsConfig, shortest: Tensor, longest: Tensor) -> None:
        super().__init__()
        self.skills = config.n_skills or 1
        self.width = 2 * self.skills + 1 if config.skill_memory else 0
        self.register_buffer("shortest", shortest.clone())
        self.register_buffer("longest", longest.clone())

    def forward(self, held: Tensor, held_for: Tensor, finished: Tensor) -> Tensor:
        """Builds the memory; all 0 before the first decision.

        Args:
            held: ``(B,)`` int64 skill in force, or `labels.UNDECIDED`.
            held_for: ``(B,)`` int64 frames for which it has been; beyond what demonstrations show it counts as that.
            finished: ``(B, K)`` how often every skill had been done before.

        Returns:
            ``(B, 2 K + 1)`` floats, or ``(B, 0)`` for a meta controller without memory.
        """
        if not self.width:
            return finished.new_zeros(len(finished), 0)
        known = held.clamp(min=0)
        decided = (held >= 0).to(finished)
        share = (held_for / self.longest[known]).clamp(max=1) * decided
        present = F.one_hot(known, self.skills) * decided[:, None]
        return torch.cat([present, share[:, None], finished], dim=1)

    def widen(self, shortest: Tensor, longest: Tensor) -> None:
        """Takes in the segments of another dataset, which a checkpoint is trained further on."""
        self.shortest.copy_(torch.minimum(self.shortest, shortest.to(self.shortest)))
        self.longest.copy_(torch.maximum(self.longest, longest.to(self.longest)))

    def counts(self, held: Tensor, held_for: Tensor) -> Tensor:
        """Tells whether a skill that is left has been done, or only tried: ``(B,)`` bool.

        It has been done after half the time of its shortest segment; what flickers would spoil the memory for good.
        """
        return (held >= 0) & (2 * held_for >= self.shortest[held.clamp(min=0)])


@dataclass(frozen=True)
class MetaLosses:
    """The terms of the meta controller's loss and what it would do when acting, per sample, ``(B,)`` floats each.

    Attributes:
        skill_id_loss: Cross-entropy of the skill.
        subgoal_loss: Squared error of the subgoal that is decoded from the posterior.
        kl_loss: Divergence of the posterior from the prior (nats).
        skill_id_accuracy: Whether the most probable skill is the right one.
        imagined_subgoal_loss: Squared error of the subgoal decoded from the prior, as in a rollout; not trained on.
    """

    skill_id_loss: Tensor
    subgoal_loss: Tensor
    kl_loss: Tensor
    skill_id_accuracy: Tensor
    imagined_subgoal_loss: Tensor


class MetaController(nn.Module):
    """Skill id and subgoal of one task, or of all (paper, section on the meta controller).

    The id head returns logits; the released code took the softmax twice. What the memory says is added to them: so what
    is seen keeps its say, and where the memory does not count, nothing is missing. With encoder "conv" the image
    feature are keypoints instead of a global average, which over few channels would lose where things are.

    Args:
        config: A configuration that is completed.
        n_tasks: Tasks that it is told apart by; 0 if it is not told the task.
        memory: Width of the memory.
        map_channels: Channels of the maps of the skills' trunk.
    """

    def __init__(self, config: BudsConfig, n_tasks: int, memory: int, map_channels: int) -> None:
        super().__init__()
        if config.meta_trunk == "skills":
            trunk, feature = cast(nn.Module, nn.Identity()), map_channels
        else:
            trunk, feature = make_trunk(config, config.meta_channels, stages=4)
        if config.encoder == "resnet18":
            self.image_encoder = make_pooled_encoder(trunk)
        else:
            self.image_encoder = make_keypoint_encoder(trunk, feature, config.keypoints, config.meta_conv_feature)
            feature = config.meta_conv_feature
        skills = config.n_skills or 1
        feature += n_tasks + (config.proprio_size if config.meta_proprioception else 0)
        self.n_tasks, self.latent = n_tasks, config.meta_latent
        self.drawn_subgoals = config.drawn_subgoals
        self.seen_skills = skills if config.decoder_sees_skill else 0
        self.posterior = make_mlp([feature + config.subgoal_dim, *config.meta_encoder_widths, 2 * self.latent])
        decoder_inputs = feature + self.seen_skills + self.latent
        self.decoder = make_mlp([decoder_inputs, *config.meta_head_widths, config.subgoal_dim])
        self.id_head = make_mlp([feature, *config.meta_head_widths, skills])
        self.memory_head = make_mlp([memory, MEMORY_WIDTH, skills]) if memory else None

    def propose(self, situation: Situation) -> tuple[Tensor, Tensor]:
        """Rates the skills.

        Args:
            situation: What the decision is made from.

        Returns:
            ``(B, F)`` features of the observation, and ``(B, K)`` logits of the skills.
        """
        parts = [self.image_encoder(situation.images), situation.proprio]
        if self.n_tasks:
            parts.append(F.one_hot(situation.task, self.n_tasks).to(parts[0]))
        feature = torch.cat(parts, dim=1)
        logits = self.id_head(feature)
        if self.memory_head is not None:
            logits = logits + MEMORY_SAY * torch.tanh(self.memory_head(situation.memory)) * situation.remembers
        return feature, logits

    def imagine(self, feature: Tensor, skill: Tensor, latent: Tensor) -> Tensor:
        """Decodes subgoals.

        Args:
            feature: ``(B, F)`` what `propose` returned.
            skill: ``(B,)`` int64 skills that were picked.
            latent: ``(B, latent)`` numbers from a standard normal distribution.

        Returns:
            ``(B, d)`` subgoals.
        """
        seen = [F.one_hot(skill, self.seen_skills).to(feature)] if self.seen_skills else []
        subgoals: Tensor = self.decoder(torch.cat([feature, *seen, latent], dim=1))
        return subgoals

    def losses(self, situation: Situation, skill: Tensor, subgoal: Tensor) -> tuple[MetaLosses, Tensor]:
        """Computes the terms of the loss.

        Latents are drawn in training and are their means otherwise, so that a validation loss does not depend on the
        generator.

        Args:
            situation: What the decision is made from.
            skill: ``(B,)`` int64 skill labels.
            subgoal: ``(B, d)`` true subgoals, without gradient.

        Returns:
            The terms, and the subgoals imagined as in a rollout for the labelled skills, ``(B, d)`` without gradient.
        """
        feature, logits = self.propose(situation)
        mean, log_variance = self.posterior(torch.cat([feature, subgoal], dim=1)).float().chunk(2, dim=1)
        latent = mean
        if self.training:
            latent = mean + torch.exp(0.5 * log_variance) * torch.randn_like(mean)
        decoded = self.imagine(feature, skill, latent)
        with torch.no_grad():
            drawn = self.training and self.drawn_subgoals
            noise = torch.randn_like(mean) if drawn else torch.zeros_like(mean)
            imagined = self.imagine(feature, skill, noise)
        losses = MetaLosses(
            skill_id_loss=F.cross_entropy(logits, skill, reduction="none"),
            subgoal_loss=_squared_distance(decoded, subgoal),
            kl_loss=0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).sum(dim=1),
            skill_id_accuracy=(logits.argmax(dim=1) == skill).float(),
            imagined_subgoal_loss=_squared_distance(imagined, subgoal),
        )
        return losses, imagined


def _squared_distance(one: Tensor, other: Tensor) -> Tensor:
    return (one.float() - other.float()).square().sum(dim=1)


class MetaControllers(nn.Module):
    """One meta controller for every task of the configuration (paper), or one for all that is told the task (ours).

    Args:
        config: A configuration that is completed.
        memory: Width of the memory.
        map_channels: Channels of the maps of the skills' trunk.
    """

    def __init__(self, config: BudsConfig, memory: int, map_channels: int) -> None:
        super().__init__()
        n_tasks = max(1, len(config.tasks))
        numbers, told = (n_tasks, 0) if config.meta_controllers == "per_task" else (1, n_tasks)
        self.controllers = nn.ModuleList(MetaController(config, told, memory, map_channels) for _ in range(numbers))

    def grouping(self, task: Tensor) -> Grouping:
        """Groups rows by controllers, as their tasks ``(B,)`` say, which waits for a GPU where there are several."""
        return Grouping.of(task) if len(self.controllers) > 1 else Grouping.whole(len(task))

    def propose(self, situation: Situation) -> tuple[Tensor, Tensor]:
        """Rates the skills, every row by its task's meta controller, see `MetaController.propose`."""
        feature, logits = by_group(
            self.grouping(situation.task), lambda c, rows: self._controller(c).propose(situation[rows])
        )
        return feature, logits

    def imagine(self, feature: Tensor, task: Tensor, skill: Tensor, latent: Tensor) -> Tensor:
        """Decodes subgoals, every row by its task's meta controller, see `MetaController.imagine`."""
        (subgoals,) = by_group(
            self.grouping(task),
            lambda c, rows: [self._controller(c).imagine(feature[rows], skill[rows], latent[rows])],
        )
        return subgoals

    def losses(
        self, situation: Situation, skill: Tensor, subgoal: Tensor, grouping: Grouping | None = None
    ) -> tuple[MetaLosses, Tensor]:
        """Computes the terms of the loss, every row by its task's meta controller, see `MetaController.losses`.

        Args:
            situation: What the decision is made from.
            skill: ``(B,)`` int64 skill labels.
            subgoal: ``(B, d)`` true subgoals, without gradient.
            grouping: What `grouping` returned, where it has been asked.
        """

        def compute(c: int, rows: Rows) -> list[Tensor]:
            losses, imagined = self._controller(c).losses(situation[rows], skill[rows], subgoal[rows])
            return [*vars(losses).values(), imagined]

        *losses, imagined = by_group(grouping or self.grouping(situation.task), compute)
        return MetaLosses(*losses), imagined

    def _controller(self, number: int) -> MetaController:
        return cast(MetaController, self.controllers[number])
