"""What the networks are built of: image trunks, spatial softmax, perceptrons."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torchvision.models import resnet18

from .configuration_buds import BudsConfig

Trunk = tuple[nn.Module, int]
"""Layers that turn images into maps, and the channels of these."""

GROUP_WIDTH = 16
"""Channels per group of group normalisation (Wu and He 2018)."""


class Layers(nn.Sequential):
    """Layers one after the other that can be compiled: ``Module.compile`` passes over what lies in PyTorch's code."""

    def forward(self, images: Tensor) -> Tensor:
        """Runs all layers."""
        maps: Tensor = super().forward(images)  # type: ignore[no-untyped-call]
        return maps


def make_mlp(sizes: Sequence[int]) -> nn.Sequential:
    """Builds linear layers with LeakyReLU(0.01) between them and none after the last.

    Args:
        sizes: Input width, hidden widths, output width.
    """
    layers: list[nn.Module] = []
    for width_in, width_out in pairwise(sizes):
        layers += [nn.Linear(width_in, width_out), nn.LeakyReLU(0.01)]
    return nn.Sequential(*layers[:-1])


def make_norm(kind: str) -> Callable[[int], nn.Module]:
    """Returns the constructor of the normalisation ``"batch"`` or ``"group"``, called with the number of channels."""
    if kind == "batch":
        return nn.BatchNorm2d
    return lambda channels: nn.GroupNorm(max(1, channels // GROUP_WIDTH), channels)


def make_trunk(config: BudsConfig, in_channels: int, stages: int) -> Trunk:
    """Builds the trunk that a configuration names.

    Args:
        config: Says which encoder, and its sizes.
        in_channels: Channels of the input; the cameras of one frame are stacked.
        stages: Residual stages of a ResNet-18.
    """
    if config.encoder == "resnet18":
        return make_resnet_trunk(in_channels, config.norm, stages)
    return make_conv_trunk(in_channels, config.norm, config.conv_channels)


def make_resnet_trunk(in_channels: int, norm: str, stages: int) -> Trunk:
    """Builds a ResNet-18 trained from scratch, without pooling and classifier (paper, section on skills).

    Args:
        in_channels: Channels of the input; the cameras of one frame are stacked.
        norm: ``"batch"`` or ``"group"``.
        stages: How many of the four residual stages to keep; each but the first halves the map.

    Returns:
        The trunk and the channels of its maps.
    """
    net = resnet18(weights=None, norm_layer=make_norm(norm))
    if in_channels != net.conv1.in_channels:
        net.conv1 = nn.Conv2d(in_channels, net.conv1.out_channels, 7, stride=2, padding=3, bias=False)
        nn.init.kaiming_normal_(net.conv1.weight, mode="fan_out", nonlinearity="relu")
    kept = [net.layer1, net.layer2, net.layer3, net.layer4][:stages]
    return Layers(net.conv1, net.bn1, net.relu, net.maxpool, *kept), 64 * 2 ** (stages - 1)


def make_conv_trunk(in_channels: int, norm: str, channels: Sequence[int]) -> Trunk:
    """Builds a small trunk for CPUs (ours): strides 4, 2, 1, ..., so that 64 pixels become 8x8 maps.

    The large first stride is where the time goes away: later stages work on 16x16 maps and smaller.

    Args:
        in_channels: Channels of the input.
        norm: ``"batch"`` or ``"group"``.
        channels: Channels of every stage.

    Returns:
        The trunk and the channels of its maps.
    """
    layers: list[nn.Module] = []
    widths = [in_channels, *channels]
    for stage, (width_in, width_out) in enumerate(pairwise(widths)):
        kernel, stride = [(5, 4), (3, 2)][stage] if stage < 2 else (3, 1)
        layers += [
            nn.Conv2d(width_in, width_out, kernel, stride=stride, padding=kernel // 2, bias=False),
            make_norm(norm)(width_out),
            nn.ReLU(inplace=True),
        ]
    return Layers(*layers), widths[-1]


class Pointwise(nn.Conv2d):
    """A convolution of 1x1 as a product of matrices: a skill's few images took a slow way through PyTorch's on a CPU.

    Args:
        width_in: Channels of the input.
        width_out: Channels of the output.
    """

    def __init__(self, width_in: int, width_out: int) -> None:
        super().__init__(width_in, width_out, 1)

    def forward(self, maps: Tensor) -> Tensor:
        """Mixes the channels of every point, ``(B, width_in, H, W)`` to ``(B, width_out, H, W)``."""
        points = F.linear(maps.permute(0, 2, 3, 1), self.weight.flatten(1), self.bias)
        return points.permute(0, 3, 1, 2)


class SpatialSoftmax(nn.Module):
    """Turns every map into the expected position of its peak, in [-1, 1]; temperature 1 (released code)."""

    def forward(self, maps: Tensor) -> Tensor:
        """Computes the keypoints.

        Args:
            maps: ``(B, C, H, W)`` floats.

        Returns:
            ``(B, 2 C)`` floats: all x, then all y.
        """
        _, _, height, width = maps.shape
        # In half precision positions would come in steps of 1/128.
        weights = maps.float().flatten(2).softmax(dim=-1).view_as(maps)
        columns = torch.linspace(-1, 1, width, device=maps.device, dtype=weights.dtype)
        rows = torch.linspace(-1, 1, height, device=maps.device, dtype=weights.dtype)
        x = (weights.sum(dim=2) * columns).sum(dim=-1)  # (B, C)
        y = (weights.sum(dim=3) * rows).sum(dim=-1)  # (B, C)
        return torch.cat([x, y], dim=1)


def make_keypoint_encoder(trunk: nn.Module, channels: int, keypoints: int, feature: int) -> Layers:
    """Builds trunk, 1x1 convolution, spatial softmax and a linear layer (paper, section on skills).

    Args:
        trunk: Images ``(B, C, H, W)`` to maps with `channels` channels.
        channels: Channels of the trunk's maps.
        keypoints: Maps of the spatial softmax.
        feature: Width of the output ``(B, feature)``.
    """
    return Layers(trunk, Pointwise(channels, keypoints), SpatialSoftmax(), nn.Linear(2 * keypoints, feature))


def make_pooled_encoder(trunk: nn.Module) -> Layers:
    """Builds trunk and global average pooling: images to ``(B, channels)`` (released meta controller)."""
    return Layers(trunk, nn.AdaptiveAvgPool2d(1), nn.Flatten())


def random_shift(images: Tensor, padding: int) -> Tensor:
    """Shifts every sample by up to `padding` pixels, repeating the border (paper: DrQ's pad and crop).

    All channels of a sample, hence all stacked cameras, share one shift. Images come out with the channels of a pixel
    together, which convolutions are faster on.

    Args:
        images: ``(B, C, H, W)`` floats.
        padding: Largest shift (pixels); 0 changes nothing.
    """
    if padding == 0:
        return images
    batch, channels, height, width = images.shape
    shifts = torch.randint(-padding, padding + 1, (2, batch, 1, 1), device=images.device)
    rows = (torch.arange(height, device=images.device)[:, None] + shifts[0]).clamp(0, height - 1)  # (B, H, 1)
    columns = (torch.arange(width, device=images.device) + shifts[1]).clamp(0, width - 1)  # (B, 1, W)
    samples = torch.arange(batch, device=images.device)[:, None, None]
    pixels = (samples * height + rows) * width + columns  # (B, H, W)
    points = images.permute(0, 2, 3, 1).reshape(-1, channels)  # where they lie together already, nothing is moved
    return points.index_select(0, pixels.flatten()).view(batch, height, width, channels).permute(0, 3, 1, 2)


def lay_out(network: nn.Module, memory_format: torch.memory_format) -> None:
    """Puts the kernels of convolutions in another order in memory, in place.

    One image at a time, kernels with the channels together save a third of the time. In training they must lie in the
    usual order: LeRobot cannot save the state of an optimiser that takes after others.

    Args:
        network: Its parameters keep their identity.
        memory_format: ``torch.contiguous_format`` or ``torch.channels_last``.
    """
    for kernel in network.parameters():
        # Those of one pixel or one channel lie alike in both, and would not find back to their strides.
        if kernel.ndim == 4 and kernel.shape[1] > 1 and kernel.shape[2:].numel() > 1:
            kernel.data = kernel.data.contiguous(memory_format=memory_format)


def compile_encoders(network: nn.Module) -> None:
    """Compiles image encoders and trunks, in place.

    Args:
        network: What contains them.
    """
    names = {"image_encoder", "subgoal_encoder", "image_trunk", "goal_trunk"}
    encoders = [module for name, module in network.named_modules() if name.rpartition(".")[2] in names]
    # All run the same line of code, and what is compiled too often (for gradients or not, for a single row, ...)
    # falls back to what it was.
    limit = torch.compiler.config.recompile_limit
    torch.compiler.config.recompile_limit = max(limit, 4 * len(encoders))
    for encoder in encoders:
        encoder.compile(dynamic=True)  # a skill's share of a batch changes from step to step
