"""The latents of a dataset under a trained representation, computed once."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.utils.constants import HF_LEROBOT_HOME
from numpy.typing import NDArray
from tqdm import tqdm

from lerobot_buds.core import STATE, CheckpointError, DatasetError, FloatArray, sha256_of_json
from lerobot_buds.data import make_once

from .inputs import DatasetInputs, network_images
from .network import PROPRIOCEPTION
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


def encode_observations(representation: Representation, observations: Mapping[str, NDArray[Any]]) -> FloatArray:
    """Computes the latents of observations that belong to no dataset, the same that `encode_dataset` gives its frames.

    Args:
        representation: Trained on the same cameras and state; it computes where its network lies.
        observations: Cameras ``(B, 3, H, W)`` uint8 and ``observation.state`` ``(B, D)`` with all of its dimensions, by
            their names in the dataset; what the representation does not fuse may be missing.

    Returns:
        ``(B, z)`` float64, float32 in precision.

    Raises:
        CheckpointError: A camera or the state is missing, or of another size than the representation was trained on.
    """
    modalities = representation.modalities
    shapes: dict[str, tuple[int, ...]] = {camera: (3, *size) for camera, size in modalities.cameras.items()}
    if modalities.state_dims:
        shapes[STATE] = (len(modalities.state_names),)
    for name, shape in shapes.items():
        found = observations[name].shape[1:] if name in observations else None
        if found != shape:
            raise CheckpointError(
                f"the representation was trained on {name!r} of {shape}, the observation has {found}."
            )
    device = next(representation.network.parameters()).device
    size = representation.config.frame_size
    batch = {name: network_images(observations[name], size, device) for name in modalities.cameras}
    if modalities.state_dims:
        state = observations[STATE][:, list(modalities.state_dims)].astype(np.float32)
        batch[PROPRIOCEPTION] = torch.from_numpy(state).to(device)
    with torch.inference_mode():
        latents: FloatArray = representation.network.latents(batch).cpu().numpy().astype(np.float64)
    return latents


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
