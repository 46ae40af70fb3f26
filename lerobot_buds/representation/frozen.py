"""Frozen features of a pretrained network (timm) as a representation, in place of the auto-encoder.

Every camera's pooled feature is reduced by principal components and scaled to the same total variance, and
proprioception is standardised and weighted: hundreds of channels would drown a handful of joints. The pooling is the
model's own (the class token of DINOv2, the mean over places of a ResNet); LOTUS shrinks the grid of tokens to one by
nearest neighbour, which keeps the token in the corner and nothing else.
"""

from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.nn import functional

from lerobot_buds.core import CheckpointError, ConfigError, FloatArray, near_names
from lerobot_buds.data import download

from .configuration import RepresentationConfig
from .network import PROPRIOCEPTION

PUBLISHED_FILE = "model.safetensors"  # as every repository of timm's has it
MIN_VARIANCE = 1e-12  # of a camera's feature; under it the camera is black, and contributes zeros


class Projection(nn.Module):
    """An affine map fitted to data: ``(x - mean) @ matrix``.

    Args:
        features: Size of the input.
        dims: Size of the output.
    """

    mean: Tensor
    matrix: Tensor

    def __init__(self, features: int, dims: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("matrix", torch.eye(features, dims))

    def forward(self, x: Tensor) -> Tensor:
        """Maps ``(B, features)`` to ``(B, dims)``."""
        return (x - self.mean) @ self.matrix


class FrozenFeatures(nn.Module):
    """Maps all modalities to one latent without having learned any of it: `fit` sets the projections alone.

    A batch is that of `FusionNetwork`, with images of any size, which are resized (bicubic) and normalised as the
    backbone was trained.

    Args:
        cameras: Names of the cameras, in order.
        proprioception_dims: Size of the proprioceptive vector; 0 leaves the modality out.
        config: Names the backbone, the size of its images, and `latent_dim`, the components kept of each camera.
        weights: State of the backbone as timm publishes it; random where None.

    Raises:
        ConfigError: timm is not installed, or cannot build the backbone for such images and with these weights.
    """

    pixel_mean: Tensor
    pixel_std: Tensor

    def __init__(
        self,
        cameras: Sequence[str],
        proprioception_dims: int,
        config: RepresentationConfig,
        weights: Mapping[str, Tensor] | None = None,
    ) -> None:
        super().__init__()
        self.cameras = tuple(cameras)
        self.image_size, self.components = config.backbone_image_size, config.latent_dim
        self.backbone, normalisation, features = _make_backbone(str(config.backbone), self.image_size, weights)
        for name in ("mean", "std"):
            self.register_buffer(f"pixel_{name}", torch.tensor(normalisation[name])[:, None, None])
        self.camera_projections = nn.ModuleList(Projection(features, self.components) for _ in cameras)
        self.has_proprioception = proprioception_dims > 0
        if self.has_proprioception:
            self.proprioception_projection = Projection(proprioception_dims, proprioception_dims)
        self.proprioception_gain = config.proprioception_weight * sqrt(len(self.cameras))
        self.requires_grad_(False)

    def features(self, batch: Mapping[str, Tensor]) -> list[Tensor]:
        """Computes each camera's pooled feature ``(B, F)``, in their order."""
        size = (self.image_size, self.image_size)
        features = []
        for name in self.cameras:
            images = functional.interpolate(batch[name], size=size, mode="bicubic", antialias=True).clamp(0, 1)
            features.append(self.backbone((images - self.pixel_mean) / self.pixel_std))
        return features

    def latents(self, batch: Mapping[str, Tensor]) -> Tensor:
        """Computes the latent of every frame, ``(B, z)``.

        Every camera in order, scaled to a total variance of 1, then proprioception, weighted against all of them.
        """
        parts = [project(x) for project, x in zip(self.camera_projections, self.features(batch), strict=True)]
        if self.has_proprioception and self.proprioception_gain:
            parts.append(self.proprioception_gain * self.proprioception_projection(batch[PROPRIOCEPTION]))
        return torch.cat(parts, dim=1)

    @torch.no_grad()
    def fit(self, batches: Iterable[Mapping[str, Tensor]]) -> None:
        """Fits the projections to some frames; the same frames give the same projections.

        Args:
            batches: Batches of the frames.

        Raises:
            ConfigError: There are fewer frames, or channels, than principal components.
        """
        columns: list[list[Tensor]] = []
        for batch in batches:
            state = [batch[PROPRIOCEPTION]] if self.has_proprioception else []
            columns.append([x.cpu() for x in (*self.features(batch), *state)])
        modalities = [torch.cat(parts).double().numpy() for parts in zip(*columns, strict=True)]
        if self.has_proprioception:
            self.proprioception_projection.load_state_dict(_standardising(modalities.pop()))
        for projection, features in zip(self.camera_projections, modalities, strict=True):
            projection.load_state_dict(_principal_components(features, self.components))


def pretrained_weights(config: RepresentationConfig) -> dict[str, Tensor] | None:
    """Reads the weights of the backbone, from the Hub or its cache, or from a file.

    Args:
        config: Names the backbone and its weights.

    Returns:
        State as timm publishes it; None where random weights are asked for.

    Raises:
        ConfigError: timm is not installed, or neither knows the model nor weights of it.
        CheckpointError: The file is missing or damaged, or cannot be downloaded.
    """
    if config.backbone_weights == "random":
        return None
    path = Path(config.backbone_weights)
    if config.backbone_weights == "pretrained":
        source = _published(str(config.backbone))
        if source is None or not source.hf_hub_id:
            raise ConfigError(f"timm has no weights of {config.backbone!r} on the Hub: set backbone_weights to a file.")
        try:
            path = download(source.hf_hub_id, [PUBLISHED_FILE]) / PUBLISHED_FILE
        except CheckpointError as error:
            raise CheckpointError(f"{error} Or set backbone_weights to a .safetensors file of the weights.") from error
    try:
        return load_file(path)
    except (OSError, SafetensorError) as error:
        raise CheckpointError(f"{path} holds no weights of {config.backbone!r} ({error}).") from error


def _make_backbone(
    name: str, image_size: int, weights: Mapping[str, Tensor] | None
) -> tuple[nn.Module, dict[str, Any], int]:
    """Builds a timm model that ends in its pooled feature; returns also its normalisation, and the feature's size."""
    published = _published(name)
    # Models whose size is fixed must be told; the others take any image.
    size = {"img_size": image_size} if published is not None and published.fixed_input_size else {}
    overlay = None if weights is None else {"state_dict": dict(weights)}
    timm = _timm()
    try:
        # With the classifier, so that timm compares every name and shape; a model built without loads what happens to
        # fit.
        model = timm.create_model(name, pretrained=weights is not None, pretrained_cfg_overlay=overlay, **size)
        model.reset_classifier(0)
        with torch.no_grad():
            feature = model.eval()(torch.zeros(1, 3, image_size, image_size))
        _, channels = feature.shape
    except (AssertionError, RuntimeError, TypeError, ValueError) as error:
        raise ConfigError(
            f"backbone={name!r} cannot be built for images of {image_size} pixels with these weights: {error}"
        ) from error
    return model, timm.data.resolve_model_data_config(model), channels


def _published(name: str) -> Any:
    """Looks up what timm knows of a model's published weights; None where there are none."""
    timm = _timm()
    if not timm.is_model(name):
        near = get_close_matches(name, timm.list_models(), n=5)
        raise ConfigError(f"timm {timm.__version__} has no model {name!r}. {near_names(name, near)}")
    try:
        return timm.get_pretrained_cfg(name)
    except RuntimeError as error:  # an unknown tag; the message lists the known ones
        raise ConfigError(str(error)) from error


def _principal_components(features: FloatArray, dims: int) -> dict[str, Tensor]:
    from sklearn.decomposition import PCA  # seconds of importing that no auto-encoder needs

    if dims > min(features.shape):
        raise ConfigError(
            f"latent_dim={dims} components cannot be had from {len(features)} training frames of {features.shape[1]} "
            "channels; lower latent_dim."
        )
    if features.var(axis=0).sum() < MIN_VARIANCE:
        return _projection(features.mean(axis=0), np.zeros((features.shape[1], dims)))
    found = PCA(dims, svd_solver="covariance_eigh").fit(features)
    return _projection(found.mean_, found.components_.T / np.sqrt(found.explained_variance_.sum()))


def _standardising(values: FloatArray) -> dict[str, Tensor]:
    std = values.std(axis=0)
    moving = std > 1e-6  # constant dimensions stay at zero
    scale = np.divide(1.0, std, where=moving, out=np.zeros_like(std))
    return _projection(values.mean(axis=0), np.diag(scale / np.sqrt(max(moving.sum(), 1))))


def _projection(mean: FloatArray, matrix: FloatArray) -> dict[str, Tensor]:
    return {"mean": torch.from_numpy(mean), "matrix": torch.from_numpy(matrix)}


def _timm() -> Any:
    try:
        import timm
    except ImportError as error:
        raise ConfigError(
            "a backbone needs timm, which is not installed: pip install 'lerobot_policy_buds[timm]'"
        ) from error
    return timm
