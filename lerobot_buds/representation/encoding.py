"""The latents of a dataset under a trained representation, computed once."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from accelerate import PartialState  # type: ignore[import-untyped]
from accelerate.utils import broadcast_object_list, gather_object  # type: ignore[import-untyped]
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from lerobot_buds.core import STATE, CheckpointError, DatasetError, FloatArray, sha256_of_json
from lerobot_buds.data import AnyDataset, FrameStore, as_floats, make_once, scale_images, used_size

from .feed import Feed
from .inputs import DatasetInputs
from .network import PROPRIOCEPTION
from .trained import Representation


def encode_dataset(
    dataset: AnyDataset, representation: Representation, batch_size: int = 32, cache_dir: Path | None = None
) -> list[FloatArray]:
    """Computes the latent of every chosen frame: the mean of the fused posterior (code), or frozen features.

    Latents are kept in the frame store by the hash of weights and data, so a second call only reads. Under ``accelerate
    launch`` every process takes its share of the batches; all must call, and all return the same.

    Args:
        dataset: What stands for the dataset; its chosen episodes must be whole on this machine.
        representation: Trained on the same cameras and state.
        batch_size: Frames per pass. 32: the fastest on CPUs, whose caches larger ones leave (measured).
        cache_dir: Folder of the frame store; ``$HF_LEROBOT_HOME/buds_cache`` where None.

    Returns:
        One ``(T, z)`` float64 array per chosen episode, float32 in precision.

    Raises:
        CheckpointError: The dataset's cameras or state differ from those the representation was trained on.
        DatasetError: The dataset is damaged or incomplete, or a latent is not finite.
        StorageError: The store cannot be written.
    """
    representation.modalities.require_same(dataset)
    state = PartialState(cpu=representation.config.device == "cpu")
    inputs = DatasetInputs(dataset, representation.modalities, representation.config.side, cache_dir)
    key = sha256_of_json({"representation": representation.hash, "data": inputs.fingerprint, "batch_size": batch_size})
    store = FrameStore.open(cache_dir)
    path = store.folder / f"latents-{key[:32]}.npy"
    (kept,) = broadcast_object_list([path.exists()])  # one answer for all, for they must do the same
    if kept:
        latents = np.load(path, allow_pickle=False)
    else:
        latents = _checked(_encode(inputs, representation, batch_size, state), inputs)
        if state.is_main_process:
            store.reserve(path, latents.nbytes)
            make_once(path, lambda part: _write_array(part, latents))
        state.wait_for_everyone()
    parts: list[FloatArray] = np.split(latents.astype(np.float64), np.cumsum(inputs.ends - inputs.starts)[:-1])
    return parts


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
    batch = {}
    for name, stored in modalities.cameras.items():
        frames = torch.from_numpy(observations[name]).to(device)
        batch[name] = as_floats(scale_images(frames, used_size(stored, representation.config.side)))
    if modalities.state_dims:
        state = observations[STATE][:, list(modalities.state_dims)].astype(np.float32)
        batch[PROPRIOCEPTION] = torch.from_numpy(state).to(device)
    with torch.inference_mode():
        latents: FloatArray = representation.network.latents(batch).cpu().numpy().astype(np.float64)
    return latents


def _encode(
    inputs: DatasetInputs, representation: Representation, batch_size: int, state: PartialState
) -> NDArray[np.float32]:
    """Encodes the chosen frames, every n-th batch of them in each of n processes; ``(M, z)`` in all of them."""
    network = representation.network.to(state.device)
    batches = np.array_split(inputs.rows, range(batch_size, len(inputs.rows), batch_size))
    mine = range(state.process_index, len(batches), state.num_processes)
    feed = Feed(inputs, state.device, again=False)
    encoded: list[Tensor] = []
    with torch.inference_mode():
        fetched = feed.batches(batches[number] for number in mine)
        for batch in tqdm(fetched, "encoding", len(mine), unit="batch", leave=False, disable=not state.is_main_process):
            encoded.append(network.latents(batch))  # stays on the device, which need not be waited for
    network.to("cpu")
    parts = [(number, part.cpu().numpy()) for number, part in zip(mine, encoded, strict=True)]
    return np.concatenate([part for _, part in sorted(gather_object(parts), key=lambda pair: int(pair[0]))])


def _checked(latents: NDArray[np.float32], inputs: DatasetInputs) -> NDArray[np.float32]:
    bad = np.argwhere(~np.isfinite(latents))
    if len(bad):
        place, dim = bad[0]
        row = inputs.rows[place]
        episode = int(np.searchsorted(inputs.ends, row, side="right"))
        raise DatasetError(
            f"the latent of episode {inputs.numbers[episode]}, frame {row - inputs.starts[episode]}, dimension {dim} "
            f"is {latents[place, dim]}, and {len(np.unique(bad[:, 0])) - 1} more frame(s) are affected; the "
            "representation is broken: train it again with a lower learning_rate."
        )
    return latents


def _write_array(path: Path, array: NDArray[np.float32]) -> None:
    with path.open("wb") as file:
        np.save(file, array, allow_pickle=False)
