"""The multi-sensory variational auto-encoder: one expert per modality, fused by a product of Gaussians.

Sizes follow the released code at 128 pixels; other square sizes use as many halving stages as fit. Three things differ
on purpose: *every* modality enters the product (the released code forgets the wrist camera), proprioception is
standardised, and no leaky rectifier stands before the decoder's sigmoid, where it made dark pixels hard to reach. There
are no skip connections.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

SLOPE = 0.1  # of every leaky rectifier (code)
MIN_VARIANCE = 1e-6  # keeps precisions finite (code)
REFERENCE_SIZE = 128  # pixels; kl_weight is relative to errors summed over images of this size
PROPRIOCEPTION = "proprioception"
"""Name of the proprioceptive modality; all others are cameras."""


class Gaussian(NamedTuple):
    """A batch of diagonal Gaussians.

    Attributes:
        mean: ``(B, z)``.
        variance: ``(B, z)``, positive.
    """

    mean: Tensor
    variance: Tensor


def product_of_experts(experts: Sequence[Gaussian]) -> Gaussian:
    """Multiplies the experts' densities with the prior ``N(0, 1)`` (paper; the prior is part of the released code).

    Args:
        experts: Gaussians of equal shape, at least one.

    Returns:
        ``variance = 1 / (1 + sum_m 1 / v_m)`` and ``mean = variance * sum_m mean_m / v_m``, elementwise.
    """
    precision = torch.ones_like(experts[0].mean)
    weighted = torch.zeros_like(experts[0].mean)
    for mean, variance in experts:
        precision = precision + 1 / variance
        weighted = weighted + mean / variance
    return Gaussian(weighted / precision, 1 / precision)


def kl_to_prior(posterior: Gaussian) -> Tensor:
    """Computes ``KL(posterior || N(0, 1))`` summed over the latent dimensions, ``(B,)``."""
    mean, variance = posterior
    return 0.5 * (variance + mean.square() - 1 - variance.log()).sum(dim=1)


def _stage_count(size: int) -> int:
    # Halve until a side is 2 or 3 pixels: 6 stages for 128, 5 for 64, 84 and 96.
    return size.bit_length() - 2


def _gaussian_of(raw: Tensor) -> Gaussian:
    # Under mixed precision the encoders end in bfloat16, too coarse for precisions, their product and the KL.
    mean, variance = raw.float().chunk(2, dim=1)
    return Gaussian(mean, functional.softplus(variance) + MIN_VARIANCE)


class ImageEncoder(nn.Module):
    """One camera's expert (222,400 parameters at 128 pixels and z = 32).

    Args:
        size: Side of the square image (pixels).
        latent_dim: Size of the latent z.
    """

    def __init__(self, size: int, latent_dim: int) -> None:
        super().__init__()
        stages = _stage_count(size)
        widths = [3, *([16, 32, 64, 64] + [128] * stages)[: stages - 1], latent_dim]
        kernels = ([7, 5, 5] + [3] * stages)[:stages]
        layers: list[nn.Module] = []
        side = size
        for i, kernel in enumerate(kernels):
            layers += [nn.Conv2d(widths[i], widths[i + 1], kernel, stride=2, padding=kernel // 2), nn.LeakyReLU(SLOPE)]
            side = (side + 1) // 2
        self.convolutions = nn.Sequential(*layers)
        self.head = nn.Linear(latent_dim * side * side, 2 * latent_dim)

    def forward(self, image: Tensor) -> Gaussian:
        """Maps ``(B, 3, S, S)`` float in [0, 1] to a Gaussian over ``(B, z)``."""
        return _gaussian_of(self.head(self.convolutions(image).flatten(1)))


class ImageDecoder(nn.Module):
    """Reconstructs one camera's image from the latent alone (151,104 parameters at 128 pixels and z = 32).

    Args:
        size: Side of the square image (pixels).
        latent_dim: Size of the latent z.
    """

    def __init__(self, size: int, latent_dim: int) -> None:
        super().__init__()
        stages = _stage_count(size)
        widths = [64, *([64] + [32] * stages)[: stages - 1], 3]
        self.size = size
        self.base = -(-size // 2**stages)
        layers: list[nn.Module] = [nn.Conv2d(latent_dim, 64, 1)]
        for i in range(stages):
            layers += [nn.LeakyReLU(SLOPE), nn.ConvTranspose2d(widths[i], widths[i + 1], 4, 2, 1, bias=False)]
        self.deconvolutions = nn.Sequential(*layers, nn.Sigmoid())

    def forward(self, latent: Tensor) -> Tensor:
        """Maps ``(B, z)`` to ``(B, 3, S, S)`` in [0, 1]."""
        grid = latent[:, :, None, None].expand(-1, -1, self.base, self.base)
        image: Tensor = self.deconvolutions(grid)
        margin = (image.shape[-1] - self.size) // 2  # sizes that are no power of two are cut out of the middle
        return image[:, :, margin : margin + self.size, margin : margin + self.size]


class ProprioceptionEncoder(nn.Module):
    """The proprioceptive expert (83,776 parameters for 5 dimensions and z = 32).

    Args:
        dims: Size of the proprioceptive vector.
        latent_dim: Size of the latent z.
    """

    def __init__(self, dims: int, latent_dim: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(dims, 256),
            nn.LeakyReLU(SLOPE),
            nn.Linear(256, 256),
            nn.LeakyReLU(SLOPE),
            nn.Linear(256, 2 * latent_dim),
        )

    def forward(self, proprioception: Tensor) -> Gaussian:
        """Maps standardised ``(B, D)`` to a Gaussian over ``(B, z)``."""
        return _gaussian_of(self.layers(proprioception))


class ProprioceptionDecoder(nn.Sequential):
    """Reconstructs standardised proprioception from the latent (21,381 parameters for 5 dimensions and z = 32).

    Args:
        dims: Size of the proprioceptive vector.
        latent_dim: Size of the latent z.
    """

    def __init__(self, dims: int, latent_dim: int) -> None:
        super().__init__(
            nn.Linear(latent_dim, 128),
            nn.LeakyReLU(SLOPE),
            nn.Linear(128, 128),
            nn.LeakyReLU(SLOPE),
            nn.Linear(128, dims),
        )


class FusionNetwork(nn.Module):
    """Encodes all modalities into one Gaussian and decodes each of them from it.

    A batch is a mapping from modality to tensor: cameras by their feature name, ``(B, 3, S, S)`` float32 in [0, 1], and
    `PROPRIOCEPTION`, ``(B, D)`` float32 in the dataset's units.

    Args:
        cameras: Names of the cameras, in order.
        proprioception_dims: Size of the proprioceptive vector; 0 leaves the modality out.
        image_size: Side of the square images (pixels).
        latent_dim: Size of the latent z.
        proprioception_weight: How much proprioception counts beside the fused latent, see `latents`.
    """

    proprioception_mean: Tensor
    proprioception_std: Tensor
    latent_scale: Tensor
    proprioception_scale: Tensor

    def __init__(
        self,
        cameras: Sequence[str],
        proprioception_dims: int,
        image_size: int,
        latent_dim: int,
        proprioception_weight: float = 0.0,
    ) -> None:
        super().__init__()
        self.cameras = tuple(cameras)
        self.proprioception_weight = proprioception_weight
        self.image_scale = (REFERENCE_SIZE / image_size) ** 2
        # Module names must not hold dots, and camera names do: cameras are numbered in their order.
        self.image_encoders = nn.ModuleList(ImageEncoder(image_size, latent_dim) for _ in cameras)
        self.image_decoders = nn.ModuleList(ImageDecoder(image_size, latent_dim) for _ in cameras)
        self.has_proprioception = proprioception_dims > 0
        if self.has_proprioception:
            self.proprioception_encoder = ProprioceptionEncoder(proprioception_dims, latent_dim)
            self.proprioception_decoder = ProprioceptionDecoder(proprioception_dims, latent_dim)
        self.register_buffer("proprioception_mean", torch.zeros(proprioception_dims))
        self.register_buffer("proprioception_std", torch.ones(proprioception_dims))
        self.register_buffer("latent_scale", torch.ones(()))
        self.register_buffer("proprioception_scale", torch.ones(()))
        # Half the training time on CPUs, and one layout everywhere keeps results equal to the bit.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def encode(self, batch: Mapping[str, Tensor]) -> Gaussian:
        """Fuses every modality; the posterior mean is the latent of a frame.

        Args:
            batch: All modalities of the network.

        Returns:
            Posterior over ``(B, z)``.
        """
        experts = [encoder(batch[name]) for name, encoder in zip(self.cameras, self.image_encoders, strict=True)]
        if self.has_proprioception:
            experts.append(self.proprioception_encoder(self._standardised(batch)))
        return product_of_experts(experts)

    def latents(self, batch: Mapping[str, Tensor]) -> Tensor:
        """Computes the latent of every frame: the mean of the posterior (code), and proprioception beside it (ours).

        In the fused latent a few joints count next to nothing beside thousands of pixels.

        Args:
            batch: All modalities of the network.

        Returns:
            ``(B, z + D)``: the mean scaled to a total variance of 1, and the standardised proprioception to one of
            ``proprioception_weight ** 2``; without the latter where the weight is 0.
        """
        fused, *proprioception = self._parts(batch)
        gain = self.proprioception_weight / self.proprioception_scale
        beside = [gain * part for part in proprioception if self.proprioception_weight]
        return torch.cat([fused / self.latent_scale, *beside], dim=1)

    @torch.no_grad()
    def fit(self, batches: Iterable[Mapping[str, Tensor]]) -> None:
        """Fits the scales of `latents` to some frames, after training.

        Args:
            batches: Batches of the frames.
        """
        columns = zip(*(self._parts(batch) for batch in batches), strict=True)
        for scale, parts in zip((self.latent_scale, self.proprioception_scale), columns, strict=False):
            total = torch.cat(parts).double().var(dim=0, correction=0).sum()
            scale.copy_(total.clamp(min=MIN_VARIANCE).sqrt())

    def decode(self, latent: Tensor) -> dict[str, Tensor]:
        """Reconstructs every modality from ``(B, z)``; proprioception comes back standardised."""
        decoded = {name: decoder(latent) for name, decoder in zip(self.cameras, self.image_decoders, strict=True)}
        if self.has_proprioception:
            decoded[PROPRIOCEPTION] = self.proprioception_decoder(latent)
        return decoded

    def forward(self, batch: Mapping[str, Tensor], noise: Tensor, kl_weight: float) -> dict[str, Tensor]:
        """Computes the loss: squared errors summed per frame plus the weighted KL, averaged over the frames.

        The errors of an image are scaled to the reference size, so that `kl_weight` means the same at any image size.

        Args:
            batch: All modalities of the network.
            noise: ``(B, z)`` standard normal draws for the posterior sample.
            kl_weight: Weight of the KL divergence.

        Returns:
            Scalars: one error per modality, ``"kl"`` (unweighted) and ``"loss"``.
        """
        posterior = self.encode(batch)
        decoded = self.decode(posterior.mean + posterior.variance.sqrt() * noise)
        terms = {
            name: (decoded[name] - batch[name]).square().sum() * (self.image_scale / len(noise))
            for name in self.cameras
        }
        if self.has_proprioception:
            error = decoded[PROPRIOCEPTION] - self._standardised(batch)
            terms[PROPRIOCEPTION] = error.square().sum() / len(noise)
        total = torch.stack(list(terms.values())).sum()
        terms["kl"] = kl_to_prior(posterior).mean()
        terms["loss"] = total + kl_weight * terms["kl"]
        return terms

    def _parts(self, batch: Mapping[str, Tensor]) -> list[Tensor]:
        """Computes the fused mean and, if it is fused, the standardised proprioception."""
        return [self.encode(batch).mean, *([self._standardised(batch)] if self.has_proprioception else [])]

    def _standardised(self, batch: Mapping[str, Tensor]) -> Tensor:
        return (batch[PROPRIOCEPTION] - self.proprioception_mean) / self.proprioception_std
