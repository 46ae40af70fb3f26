"""The meta controller: picks the skill from the workspace image and imagines its subgoal with a conditional VAE."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .configuration_buds import BudsConfig
from .encoders import make_conv_trunk, make_keypoint_encoder, make_mlp, make_pooled_encoder, make_resnet_trunk


@dataclass(frozen=True)
class MetaLosses:
    """The terms of the meta controller's loss, means over the batch (scalars), and the accuracy of its choice."""

    skill_id: Tensor
    subgoal: Tensor
    kl: Tensor
    accuracy: Tensor


class MetaController(nn.Module):
    """Skill id and subgoal from one workspace image (paper, section on the meta controller).

    The id head returns logits; the released code took the softmax twice. The subgoal decoder does not see the skill
    id, as published. With encoder "conv" the image feature are keypoints instead of a global average, which over the
    few channels of a small trunk would lose where things are.

    Args:
        config: A configuration whose features and dimensions are settled.
    """

    def __init__(self, config: BudsConfig) -> None:
        super().__init__()
        channels = config.image_features[config.cameras[0]].shape[0]
        if config.encoder == "resnet18":
            trunk, feature = make_resnet_trunk(channels, config.norm, stages=4)
            self.image_encoder = make_pooled_encoder(trunk)
        else:
            trunk, maps = make_conv_trunk(channels, config.norm, config.conv_channels)
            feature = config.meta_conv_feature
            self.image_encoder = make_keypoint_encoder(trunk, maps, config.keypoints, feature)
        self.latent = config.meta_latent
        self.posterior = make_mlp([feature + config.subgoal_dim, *config.meta_encoder_widths, 2 * self.latent])
        self.decoder = make_mlp([feature + self.latent, *config.meta_head_widths, config.subgoal_dim])
        self.id_head = make_mlp([feature, *config.meta_head_widths, config.n_skills or 1])

    def forward(self, image: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Decides.

        Args:
            image: ``(B, C, H, W)`` workspace image in [0, 1].
            noise: ``(B, latent)`` standard normal numbers, the latent of the subgoal.

        Returns:
            ``(B,)`` int64 skill ids, and ``(B, subgoal_dim)`` subgoals.
        """
        feature = self.image_encoder(image)
        return self.id_head(feature).argmax(dim=1), self.decoder(torch.cat([feature, noise], dim=1))

    def losses(self, image: Tensor, skill: Tensor, subgoal: Tensor) -> MetaLosses:
        """Computes the terms of the loss.

        The latent is drawn from the posterior in training and is its mean otherwise, so that a validation loss does
        not depend on the generator.

        Args:
            image: ``(B, C, H, W)`` workspace image in [0, 1].
            skill: ``(B,)`` int64 skill labels.
            subgoal: ``(B, subgoal_dim)`` encoded goal images, without gradient.
        """
        feature = self.image_encoder(image)
        logits = self.id_head(feature)
        mean, log_variance = self.posterior(torch.cat([feature, subgoal], dim=1)).chunk(2, dim=1)
        latent = mean
        if self.training:
            latent = mean + torch.exp(0.5 * log_variance) * torch.randn_like(mean)
        decoded = self.decoder(torch.cat([feature, latent], dim=1))
        kl = 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance)
        return MetaLosses(
            skill_id=F.cross_entropy(logits, skill),
            subgoal=(decoded - subgoal).square().sum(dim=1).mean(),
            kl=kl.sum(dim=1).mean(),
            accuracy=(logits.argmax(dim=1) == skill).float().mean(),
        )
