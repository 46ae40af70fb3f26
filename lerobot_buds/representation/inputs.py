"""Turns a dataset into batches of the network's modalities, and says which modalities those are."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_buds.core import STATE, CheckpointError, DatasetError, IntArray, dims_used, sha256_of_json
from lerobot_buds.data import (
    AnyDataset,
    FrameTable,
    LocalDataset,
    as_floats,
    cached_frames,
    chosen_cameras,
    dimension_names,
    frame_size,
    frames_key,
    read_table,
    require_finite,
    require_whole,
    used_size,
)

from .configuration import RepresentationConfig
from .network import PROPRIOCEPTION

logger = logging.getLogger(__name__)

OURS = ("eef*", "gripper*")
"""What is fused of the state of our own environments: end effector position and gripper fingers (released code)."""


@dataclass(frozen=True)
class Modalities:
    """What a representation fuses, by name and size; kept with its weights and compared with every dataset it meets.

    Attributes:
        cameras: Image feature to (height, width) of the stored frames (pixels).
        state_names: Names of all dimensions of ``observation.state``; empty without proprioception.
        state_dims: The dimensions of them that are fused.
    """

    cameras: Mapping[str, tuple[int, int]]
    state_names: tuple[str, ...]
    state_dims: tuple[int, ...]

    @classmethod
    def select(cls, dataset: AnyDataset, config: RepresentationConfig) -> "Modalities":
        """Selects the modalities that a configuration asks for from those that a dataset has, and logs them by name.

        Args:
            dataset: What stands for the dataset.
            config: Names the cameras and the proprioceptive dimensions.

        Raises:
            DatasetError: A camera, or the state, is missing; a camera holds no RGB images, or frames that are smaller
                than ``image_size``.
            ConfigError: A pattern of ``proprioception`` matches no dimension of the state.
        """
        local = LocalDataset.of(dataset)
        cameras = chosen_cameras(local.features, config.cameras, "--representation.cameras")
        with_state = config.proprioception != []
        local.require([*cameras, *([STATE] if with_state else [])])
        if not cameras and not with_state:
            raise DatasetError(f"{local.root} has no camera, and proprioception is left out: nothing to represent.")
        sizes = {name: frame_size(local.features[name], name) for name in cameras}
        for name, size in sizes.items():
            if config.backbone is None and min(size) < config.image_size:
                raise DatasetError(
                    f"{local.root}: frames of {name!r} are {size[0]} x {size[1]} pixels, image_size asks for "
                    f"{config.image_size}. Set image_size to at most {min(min(s) for s in sizes.values())}."
                )
        names = tuple(dimension_names(local.features[STATE])) if with_state else ()
        dims = tuple(dims_used("representation.proprioception", names, config.proprioception, OURS))
        logger.info("the representation uses cameras %s, and %s of the state", sizes, [names[dim] for dim in dims])
        return cls(sizes, names, dims)

    def require_same(self, dataset: AnyDataset) -> None:
        """Refuses a dataset whose cameras or state differ from those the representation was trained on.

        Args:
            dataset: What stands for the dataset.

        Raises:
            DatasetError: A modality is missing.
            CheckpointError: A frame size or the state's names differ; both sides are named.
        """
        local = LocalDataset.of(dataset)
        local.require([*self.cameras, *([STATE] if self.state_dims else [])])
        for name, size in self.cameras.items():
            stored = frame_size(local.features[name], name)
            if stored != tuple(size):
                raise CheckpointError(
                    f"the representation was trained on {name!r} of {size[0]} x {size[1]} pixels, but {local.root} "
                    f"holds {stored[0]} x {stored[1]}. Train one on this dataset."
                )
        names = tuple(dimension_names(local.features[STATE])) if self.state_dims else ()
        if names != tuple(self.state_names):
            raise CheckpointError(
                f"the representation was trained on {STATE!r} of {list(self.state_names)}, but {local.root} holds "
                f"{list(names)}. Train one on this dataset."
            )


class DatasetInputs:
    """All chosen frames of a dataset, ready to be fetched as batches.

    Args:
        dataset: What stands for the dataset; its chosen episodes must be whole on this machine.
        modalities: What to fetch.
        side: Side of the square images in a batch (pixels), see `used_size`.
        cache_dir: Folder of the frame store; in LeRobot's home where None.

    Attributes:
        numbers: ``(E,)`` numbers of the chosen episodes.
        starts: ``(E,)`` absolute index of every chosen episode's first frame.
        ends: ``(E,)`` one past every chosen episode's last frame.
        rows: ``(M,)`` absolute indices of all chosen frames, in ascending order.
        arrays: What batches are made of, by absolute index: frames ``(N, 3, H, W)`` uint8 of every camera, and, if
            fused, `PROPRIOCEPTION` ``(N, D)`` float32.
        fingerprint: Hash of everything that the batches are made of.

    Raises:
        DatasetError: Rows are missing, the state is not finite, or frames cannot be decoded.
        StorageError: The frames do not fit into the frame store.
    """

    def __init__(self, dataset: AnyDataset, modalities: Modalities, side: int, cache_dir: Path | None = None) -> None:
        local = LocalDataset.of(dataset)
        table = read_table(local, [STATE] if modalities.state_dims else [])
        require_whole(table)
        self.numbers, self.starts, self.ends, self.rows = table.numbers, table.starts, table.ends, table.rows
        sizes = {name: used_size(size, side) for name, size in modalities.cameras.items()}
        state = _state(table, modalities)
        self.arrays: dict[str, NDArray[Any]] = {
            name: cached_frames(local, name, cache_dir, size) for name, size in sizes.items()
        }
        if state is not None:
            self.arrays[PROPRIOCEPTION] = state
        self.fingerprint = sha256_of_json(
            {
                "frames": {name: frames_key(local, name, size) for name, size in sizes.items()},
                "state": None if state is None else sha256(state[self.rows].tobytes()).hexdigest(),
                "starts": self.starts.tolist(),
                "ends": self.ends.tolist(),
            }
        )

    def frames_of(self, episodes: IntArray) -> IntArray:
        """Lists the absolute indices of all frames of some of the chosen episodes, by their places, ``(N,)``."""
        ranges = [np.arange(self.starts[e], self.ends[e], dtype=np.int64) for e in episodes]
        return np.concatenate(ranges) if ranges else np.empty(0, dtype=np.int64)

    def batch(self, indices: IntArray, device: torch.device) -> dict[str, Tensor]:
        """Fetches frames.

        Args:
            indices: ``(B,)`` absolute frame indices.
            device: Where to put them.

        Returns:
            Cameras ``(B, 3, H, W)`` float32 in [0, 1] and, if fused, `PROPRIOCEPTION` ``(B, D)`` float32.
        """
        return as_batch({name: torch.from_numpy(array[indices]).to(device) for name, array in self.arrays.items()})

    def state_statistics(self, indices: IntArray) -> tuple[Tensor, Tensor]:
        """Computes mean and standard deviation of the proprioception, ``(D,)`` each; constant dimensions get 1.

        Args:
            indices: Absolute indices of the frames to use.
        """
        values = self.arrays[PROPRIOCEPTION][indices].astype(np.float64)
        std = values.std(axis=0)
        std[std < 1e-6] = 1.0
        return torch.from_numpy(values.mean(axis=0)).float(), torch.from_numpy(std).float()


def as_batch(rows: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Turns rows of `DatasetInputs.arrays` into a batch, where they are: bytes become floats in [0, 1]."""
    return {name: as_floats(values) if values.dtype == torch.uint8 else values for name, values in rows.items()}


def _state(table: FrameTable, modalities: Modalities) -> NDArray[np.float32] | None:
    if not modalities.state_dims:
        return None
    require_finite(table, STATE, modalities.state_names)
    state = table.columns[STATE].reshape(len(table.present), -1)
    return np.ascontiguousarray(state[:, list(modalities.state_dims)], dtype=np.float32)
