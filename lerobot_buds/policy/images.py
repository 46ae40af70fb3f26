"""Image handling inside the policy: the random shift of training, and the order in memory.

Images come out with the channels of a pixel together, which convolutions are faster on.
"""

import torch
from torch import Tensor, nn


def random_shift(images: Tensor, padding: int) -> Tensor:
    """Shifts every sample by up to `padding` pixels, repeating the border (paper: DrQ's pad and crop).

    All channels of a sample, hence all stacked cameras, share one shift.

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
    pixels = (rows * width + columns).view(batch, 1, -1).expand(-1, channels, -1)
    shifted = images.flatten(start_dim=2).gather(2, pixels).view(images.shape)
    return shifted.contiguous(memory_format=torch.channels_last)


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
