"""Turns a dataset into batches of the network's modalities, and says which modalities those are."""

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from lerobot_buds.core import IMAGE_PREFIX, STATE, CheckpointError, DatasetError, IntArray, select_dims, sha256_of_json
from lerobot_buds.data import (
    DatasetFiles,
    cached_frames,
    dimension_names,
    frame_size,
    frames_key,
    read_table,
    require_finite,
    require_whole,
)

from .configuration import RepresentationConfig
from .network import PROPRIOCEPTION


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
    def select(cls, root: Path, config: RepresentationConfig) -> "Modalities":
        """Selects the modalities that a configuration asks for from those that a dataset has.

        Args:
            root: Folder of a LeRobotDataset.
            config: Names the cameras and the proprioceptive dimensions.

        Raises:
            DatasetError: A camera, or the state, is missing, or a camera's frames are smaller than ``image_size``.
        """
        files = DatasetFiles(root)
        cameras = config.cameras
        if cameras is None:
            cameras = sorted(name for name in files.features if name.startswith(IMAGE_PREFIX))
        files.require([*cameras, *([STATE] if config.proprioception else [])])
        sizes = {name: frame_size(files.features[name], name) for name in cameras}
        for name, size in sizes.items():
            if config.frame_size and min(size) < config.frame_size:
                raise DatasetError(
                    f"{files.root}: frames of {name!r} are {size[0]} x {size[1]} pixels, image_size asks for "
                    f"{config.frame_size}. Set image_size to at most {min(min(s) for s in sizes.values())}."
                )
        if not config.proprioception:
            return cls(sizes, (), ())
        names = dimension_names(files.features[STATE])
        dims = select_dims(names, config.proprioception) or range(len(names))
        return cls(sizes, tuple(names), tuple(dims))

    def require_same(self, root: Path) -> None:
        """Refuses a dataset whose cameras or state differ from those the representation was trained on.

        Args:
            root: Folder of a LeRobotDataset.

        Raises:
            DatasetError: A modality is missing.
            CheckpointError: A frame size or the state's names differ; both sides are named.
        """
        files = DatasetFiles(root)
        files.require([*self.cameras, *([STATE] if self.state_dims else [])])
        for name, size in self.cameras.items():
            stored = frame_size(files.features[name], name)
            if stored != tuple(size):
                raise CheckpointError(
                    f"the representation was trained on {name!r} of {size[0]} x {size[1]} pixels, but {files.root} "
                    f"holds {stored[0]} x {stored[1]}. Train one on this dataset."
                )
        names = tuple(dimension_names(files.features[STATE])) if self.state_dims else ()
        if names != tuple(self.state_names):
            raise CheckpointError(
                f"the representation was trained on {STATE!r} of {list(self.state_names)}, but {files.root} holds "
                f"{list(names)}. Train one on this dataset."
            )


class DatasetInputs:
    """All frames of a dataset, ready to be fetched as batches.

    Args:
        root: Folder of a LeRobotDataset, whole on this machine.
        modalities: What to fetch.
        image_size: Side of the images in a batch (pixels); None leaves them as they are stored.
        cache_dir: Folder of the decoded frames; LeRobot's home where None.

    Attributes:
        starts: ``(E,)`` absolute index of every episode's first frame.
        ends: ``(E,)`` one past every episode's last frame.
        fingerprint: Hash of everything that the batches are made of, image size excepted.

    Raises:
        DatasetError: Rows are missing, the state is not finite, or frames cannot be decoded.
    """

    def __init__(
        self, root: Path, modalities: Modalities, image_size: int | None, cache_dir: Path | None = None
    ) -> None:
        table = read_table(root, [STATE] if modalities.state_dims else [])
        require_whole(table)
        self.starts, self.ends = table.starts, table.ends
        self._image_size = image_size
        self._state: NDArray[np.float32] | None = None
        if modalities.state_dims:
            require_finite(table, STATE, modalities.state_names)
            state = table.columns[STATE].reshape(len(table.present), -1)
            self._state = np.ascontiguousarray(state[:, list(modalities.state_dims)], dtype=np.float32)
        self._frames = {name: cached_frames(root, name, cache_dir) for name in modalities.cameras}
        self.fingerprint = sha256_of_json(
            {
                "frames": {name: frames_key(root, name) for name in modalities.cameras},
                "state": None if self._state is None else sha256(self._state.tobytes()).hexdigest(),
                "ends": self.ends.tolist(),
            }
        )

    @property
    def n_frames(self) -> int:
        """Number of frames of the dataset."""
        return int(self.ends[-1]) if len(self.ends) else 0

    def frames_of(self, episodes: IntArray) -> IntArray:
        """Lists the absolute indices of all frames of some episodes, ``(N,)``."""
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
        batch = {
            name: network_images(frames[indices], self._image_size, device) for name, frames in self._frames.items()
        }
        if self._state is not None:
            batch[PROPRIOCEPTION] = torch.from_numpy(self._state[indices]).to(device)
        return batch

    def state_statistics(self, indices: IntArray) -> tuple[Tensor, Tensor]:
        """Computes mean and standard deviation of the proprioception, ``(D,)`` each; constant dimensions get 1.

        Args:
            indices: Absolute indices of the frames to use.
        """
        assert self._state is not None
        values = self._state[indices].astype(np.float64)
        std = values.std(axis=0)
        std[std < 1e-6] = 1.0
        return torch.from_numpy(values.mean(axis=0)).float(), torch.from_numpy(std).float()


def network_images(frames: NDArray[np.uint8], size: int | None, device: torch.device) -> Tensor:
    """Turns stored frames into images for the network.

    Args:
        frames: ``(B, 3, H, W)`` uint8.
        size: Side of the square that they are scaled to, by area (pixels); None leaves them as they are stored.
        device: Where to put them.

    Returns:
        ``(B, 3, S, S)`` float32 in [0, 1].
    """
    images = torch.from_numpy(frames).to(device).contiguous(memory_format=torch.channels_last).float().div_(255)
    if size is None or images.shape[-2:] == (size, size):
        return images
    return functional.interpolate(images, size=(size, size), mode="area")
