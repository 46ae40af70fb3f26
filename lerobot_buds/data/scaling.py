"""The one way in which frames are made smaller: by areas, to whole levels, so that equal pixels stay equal bits.

Goal images come from the frame store, present images from LeRobot's loader as floats. Both pass here, and because
sums of whole levels are exact in float32, the order of the channels in memory, the batch, and the device make no
difference.
"""

import torch
from torch import Tensor
from torch.nn import functional


def scale_images(images: Tensor, size: tuple[int, int]) -> Tensor:
    """Scales images down by averaging areas, which does not alias; images of the right size pass unchanged.

    Args:
        images: ``(B, C, H, W)``: uint8, or floats in [0, 1] that are whole levels of 255, as LeRobot's are.
        size: Height and width (pixels) of the result.

    Returns:
        ``(B, C, h, w)`` of the same type; floats are whole levels of 255 again.
    """
    if tuple(images.shape[-2:]) == tuple(size):
        return images
    levels = images.float() if images.dtype == torch.uint8 else images.mul(255).round_().float()
    scaled = functional.interpolate(levels, size=size, mode="area").round_()
    return scaled.to(torch.uint8) if images.dtype == torch.uint8 else scaled.div_(255).to(images.dtype)


def as_floats(frames: Tensor) -> Tensor:
    """Turns uint8 frames ``(B, 3, H, W)`` into floats in [0, 1], the channels of a pixel together in memory.

    Convolutions are faster on that order.
    """
    return frames.contiguous(memory_format=torch.channels_last).float().div_(255)
