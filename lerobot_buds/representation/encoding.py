"""The latents of a dataset under a trained representation, computed once."""

from pathlib import Path

import numpy as np
import torch
from lerobot.utils.constants import HF_LEROBOT_HOME
from numpy.typing import NDArray
from tqdm import tqdm

from lerobot_buds.core import DatasetError, FloatArray, sha256_of_json
from lerobot_buds.demos import make_once

from .inputs import DatasetInputs
from .trained import Representation


def encode_dataset(
    root: Path, representation: Representation, batch_size: int = 32, cache_dir: Path | None = None
) -> list[FloatArray]:
    """Computes the latent of every frame: the mean of the fused posterior (code), or frozen features.

    Latents are kept on disk by the hash of weights and data, so a second call only reads.

    Args:
        root: Folder of a LeRobotDataset, whole on this machine.
        representation: Trained on the same cameras and state.
        batch_size: Frames per pass. 32: the fastest on CPUs, whose caches larger ones leave (measured).
        cache_dir: Folder of decoded frames and latents; ``$HF_LEROBOT_HOME/buds_cache`` where None.

    Returns:
        One ``(T, z)`` float64 array per episode, float32 in precision.

    Raises:
        CheckpointError: The dataset's cameras or state differ from those the representation was trained on.
        DatasetError: The dataset is damaged or incomplete, or a latent is not finite.
        StorageError: The cache cannot be written.
    """
    representation.modalities.require_same(root)
    inputs = DatasetInputs(root, representation.modalities, representation.config.frame_size, cache_dir)
    key = sha256_of_json({"representation": representation.hash, "data": inputs.fingerprint, "batch_size": batch_size})
    path = (cache_dir or HF_LEROBOT_HOME / "buds_cache") / f"latents-{key[:32]}.npy"
    make_once(path, lambda part: _write_array(part, _encode(inputs, representation, batch_size)))
    latents = np.load(path, allow_pickle=False).astype(np.float64)
    return [latents[start:end] for start, end in zip(inputs.starts, inputs.ends, strict=True)]


def _encode(inputs: DatasetInputs, representation: Representation, batch_size: int) -> NDArray[np.float32]:
    device = torch.device("cuda" if torch.cuda.is_available() and representation.config.device == "auto" else "cpu")
    network = representation.network.to(device)
    parts: list[NDArray[np.float32]] = []
    with torch.inference_mode():
        for start in tqdm(range(0, inputs.n_frames, batch_size), desc="encoding", unit="batch", leave=False):
            indices = np.arange(start, min(start + batch_size, inputs.n_frames))
            parts.append(network.latents(inputs.batch(indices, device)).cpu().numpy())
    network.to("cpu")
    latents = np.concatenate(parts)
    bad = np.argwhere(~np.isfinite(latents))
    if len(bad):
        row, dim = bad[0]
        episode = int(np.searchsorted(inputs.ends, row, side="right"))
        raise DatasetError(
            f"the latent of episode {episode}, frame {row - inputs.starts[episode]}, dimension {dim} is "
            f"{latents[row, dim]}, and {len(np.unique(bad[:, 0])) - 1} more frame(s) are affected; the representation "
            "is broken: train it again with a lower learning_rate."
        )
    return latents


def _write_array(path: Path, array: NDArray[np.float32]) -> None:
    with path.open("wb") as file:
        np.save(file, array, allow_pickle=False)
