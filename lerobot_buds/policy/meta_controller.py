"""The meta controller: picks the skill from the workspace image and imagines its subgoal with a conditional VAE."""

from dataclasses import dataclass
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .configuration_buds import BudsConfig
from .encoders import make_keypoint_encoder, make_mlp, make_pooled_encoder, make_trunk
from .groups import by_group


@dataclass(frozen=True)
class MetaLosses:
    """The terms of the meta controller's loss and what it would do when acting, per sample, ``(B,)`` floats each.

    The names are those under which their means are logged.

    Attributes:
        skill_id_loss: Cross-entropy of the skill.
        subgoal_loss: Squared error of the subgoal that is decoded from the posterior.
        kl_loss: Divergence of the posterior from the prior (nats).
        skill_id_accuracy: Whether the most probable skill is the right one.
        imagined_subgoal_loss: Squared error of the subgoal decoded from the prior, as in a rollout; not trained on.
        subgoal_spread: Squared distance of the true subgoal from the mean of the batch;
            `imagined_subgoal_loss` is to stay well below it.
    """

    skill_id_loss: Tensor
    subgoal_loss: Tensor
    kl_loss: Tensor
    skill_id_accuracy: Tensor
    imagined_subgoal_loss: Tensor
    subgoal_spread: Tensor


class MetaController(nn.Module):
    """Skill id and subgoal from one image (paper, section on the meta controller).

    The id head returns logits; the released code took the softmax twice. With encoder "conv" the image feature are
    keypoints instead of a global average, which over the few channels of a small trunk would lose where things are.

    Args:
        config: A configuration whose features and dimensions are settled.
        n_tasks: Tasks that it is told apart by; 0 if it is not told the task.
    """

    def __init__(self, config: BudsConfig, n_tasks: int) -> None:
        super().__init__()
        trunk, feature = make_trunk(config, config.meta_channels, stages=4)
        if config.encoder == "resnet18":
            self.image_encoder = make_pooled_encoder(trunk)
        else:
            self.image_encoder = make_keypoint_encoder(trunk, feature, config.keypoints, config.meta_conv_feature)
            feature = config.meta_conv_feature
        feature += n_tasks
        skills = config.n_skills or 1
        self.n_tasks, self.latent = n_tasks, config.meta_latent
        self.drawn_subgoals = config.drawn_subgoals
        self.told_skills = skills if config.decoder_sees_skill else 0
        self.posterior = make_mlp([feature + config.subgoal_dim, *config.meta_encoder_widths, 2 * self.latent])
        decoder_inputs = feature + self.told_skills + self.latent
        self.decoder = make_mlp([decoder_inputs, *config.meta_head_widths, config.subgoal_dim])
        self.id_head = make_mlp([feature, *config.meta_head_widths, skills])

    def propose(self, image: Tensor, task: Tensor) -> tuple[Tensor, Tensor]:
        """Rates the skills.

        Args:
            image: ``(B, C, H, W)`` image in [0, 1].
            task: ``(B,)`` int64 numbers of the tasks.

        Returns:
            ``(B, F)`` features of the observation, and ``(B, K)`` logits of the skills.
        """
        feature = self.image_encoder(image)
        if self.n_tasks:
            feature = torch.cat([feature, F.one_hot(task, self.n_tasks).to(feature)], dim=1)
        return feature, self.id_head(feature)

    def imagine(self, feature: Tensor, skill: Tensor, latent: Tensor) -> Tensor:
        """Decodes subgoals.

        Args:
            feature: ``(B, F)`` what `propose` returned.
            skill: ``(B,)`` int64 skills that were picked.
            latent: ``(B, latent)`` numbers from a standard normal distribution.

        Returns:
            ``(B, subgoal_dim)`` subgoals.
        """
        told = [F.one_hot(skill, self.told_skills).to(feature)] if self.told_skills else []
        subgoals: Tensor = self.decoder(torch.cat([feature, *told, latent], dim=1))
        return subgoals

    def losses(self, image: Tensor, task: Tensor, skill: Tensor, subgoal: Tensor) -> tuple[MetaLosses, Tensor]:
        """Computes the terms of the loss.

        Latents are drawn in training and are their means otherwise, so that a validation loss does not depend on the
        generator.

        Args:
            image: ``(B, C, H, W)`` image in [0, 1].
            task: ``(B,)`` int64 numbers of the tasks.
            skill: ``(B,)`` int64 skill labels.
            subgoal: ``(B, subgoal_dim)`` encoded goal images, without gradient.

        Returns:
            The terms, and the subgoals imagined as in a rollout for the labelled skills, ``(B, subgoal_dim)`` without
            gradient.
        """
        feature, logits = self.propose(image, task)
        mean, log_variance = self.posterior(torch.cat([feature, subgoal], dim=1)).float().chunk(2, dim=1)
        latent = mean
        if self.training:
            latent = mean + torch.exp(0.5 * log_variance) * torch.randn_like(mean)
        decoded = self.imagine(feature, skill, latent)
        with torch.no_grad():
            drawn = self.training and self.drawn_subgoals
            imagined = self.imagine(feature, skill, torch.randn_like(mean) if drawn else torch.zeros_like(mean))
        losses = MetaLosses(
            skill_id_loss=F.cross_entropy(logits, skill, reduction="none"),
            subgoal_loss=_squared_distance(decoded, subgoal),
            kl_loss=0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).sum(dim=1),
            skill_id_accuracy=(logits.argmax(dim=1) == skill).float(),
            imagined_subgoal_loss=_squared_distance(imagined, subgoal),
            subgoal_spread=_squared_distance(subgoal, subgoal.mean(dim=0)),
        )
        return losses, imagined


def _squared_distance(one: Tensor, other: Tensor) -> Tensor:
    return (one.float() - other.float()).square().sum(dim=1)


class MetaControllers(nn.Module):
    """One meta controller for every task of the configuration (paper), or one for all that is told the task (ours).

    Args:
        config: A configuration whose features, dimensions and tasks are settled.
    """

    def __init__(self, config: BudsConfig) -> None:
        super().__init__()
        n_tasks = max(1, len(config.tasks))
        self.per_task = config.meta_controllers == "per_task"
        told = 0 if self.per_task else n_tasks
        self.controllers = nn.ModuleList(MetaController(config, told) for _ in range(n_tasks if self.per_task else 1))

    def propose(self, image: Tensor, task: Tensor) -> tuple[Tensor, Tensor]:
        """Rates the skills, every row by its task's meta controller, see `MetaController.propose`."""
        feature, logits = by_group(
            self._number(task), lambda c, rows: self._controller(c).propose(image[rows], task[rows])
        )
        return feature, logits

    def imagine(self, feature: Tensor, task: Tensor, skill: Tensor, latent: Tensor) -> Tensor:
        """Decodes subgoals, every row by its task's meta controller, see `MetaController.imagine`."""
        (subgoals,) = by_group(
            self._number(task),
            lambda c, rows: [self._controller(c).imagine(feature[rows], skill[rows], latent[rows])],
        )
        return subgoals

    def losses(self, image: Tensor, task: Tensor, skill: Tensor, subgoal: Tensor) -> tuple[MetaLosses, Tensor]:
        """Computes the terms of the loss, every row by its task's meta controller, see `MetaController.losses`."""

        def compute(c: int, rows: Tensor | slice) -> list[Tensor]:
            losses, imagined = self._controller(c).losses(image[rows], task[rows], skill[rows], subgoal[rows])
            return [*vars(losses).values(), imagined]

        *losses, imagined = by_group(self._number(task), compute)
        return MetaLosses(*losses), imagined

    def _number(self, task: Tensor) -> Tensor:
        return task if self.per_task else torch.zeros_like(task)

    def _controller(self, number: int) -> MetaController:
        return cast(MetaController, self.controllers[number])
