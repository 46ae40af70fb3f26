"""A picture of what the latent keeps: frames of every camera above their reconstruction from the latent alone."""

from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure

from lerobot_buds.core import IMAGE_PREFIX, ConfigError, write_atomically
from lerobot_buds.data import AnyDataset

from .inputs import DatasetInputs
from .network import FusionNetwork
from .trained import Representation


@torch.no_grad()
def draw_reconstructions(
    dataset: AnyDataset, representation: Representation, path: Path, columns: int = 10, cache_dir: Path | None = None
) -> None:
    """Draws frames spread over the dataset, one row of originals and one of reconstructions per camera.

    Args:
        dataset: What stands for the dataset; its chosen episodes must be whole on this machine.
        representation: A trained auto-encoder with at least one camera.
        path: PNG file to write, atomically.
        columns: Number of frames.
        cache_dir: Folder of the frame store; in LeRobot's home where None.

    Raises:
        ConfigError: The representation reconstructs no images, see `Representation.draws`.
        CheckpointError: The dataset's cameras or state differ from those the representation was trained on.
        DatasetError: The dataset is damaged or incomplete.
    """
    network = representation.network
    if not representation.draws or not isinstance(network, FusionNetwork):
        raise ConfigError("this representation reconstructs no images: it has a backbone, or no camera.")
    representation.modalities.require_same(dataset)
    inputs = DatasetInputs(dataset, representation.modalities, representation.config.side, cache_dir)
    indices = inputs.rows[np.linspace(0, len(inputs.rows) - 1, columns).astype(np.int64)]
    batch = inputs.batch(indices, torch.device("cpu"))
    decoded = network.decode(network.encode(batch).mean)
    cameras = list(representation.modalities.cameras)
    rows = [
        (f"{name.removeprefix(IMAGE_PREFIX)}\n{kind}", images[name])
        for name in cameras
        for kind, images in (("original", batch), ("from latent", decoded))
    ]
    figure = Figure(figsize=(1.1 * columns + 1, 1.1 * len(rows) + 0.4), layout="constrained")
    axes = figure.subplots(len(rows), columns, squeeze=False)
    for (label, images), row in zip(rows, axes, strict=True):
        row[0].set_ylabel(label, rotation=0, ha="right", va="center")
        for image, axis in zip(images, row, strict=True):
            axis.imshow(image.permute(1, 2, 0).numpy())
            axis.set(xticks=[], yticks=[])
    for axis, index in zip(axes[0], indices, strict=True):
        axis.set_title(f"frame {index}", fontsize=8)
    write_atomically(path, lambda part: figure.savefig(part, format="png", dpi=100))
