"""Goal images: frames of the dataset that the policy is trained on, of the camera that the batch calls the workspace's.

LeRobot tells a policy neither that cameras were renamed (``--rename_map``) nor which decoder reads the videos
(``--dataset.video_backend``). The first batch shows both: its images are the dataset's own frames, to the bit.
"""

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_buds.core import CheckpointError, IntArray
from lerobot_buds.data import LocalDataset, as_floats, cached_frames, frame_size, scale_images

from .configuration_buds import BudsConfig

logger = logging.getLogger(__name__)

COMPARED = 4
"""Frames of the first batch that are compared."""

CLEARLY = 0.5
"""Where no camera shows the batch's pixels to the bit, the nearest must differ by less than this share of the next."""


class GoalImages:
    """The frames of one camera at the size that the networks see; which camera it is, the first batch shows.

    Args:
        root: Folder of the dataset.
        config: A configuration whose features are settled.
        starts: ``(E,)`` absolute index of every episode's first frame.
    """

    def __init__(self, root: Path, config: BudsConfig, starts: IntArray) -> None:
        self._root, self._starts = root, starts
        self._camera, self._size = config.stacked_cameras[0], config.image_shape
        _, height, width = config.image_features[self._camera].shape
        self._stored = (height, width)
        self._frames: NDArray[np.uint8] | None = None

    def recognise(self, rows: IntArray, images: Tensor) -> None:
        """Finds out which camera of the dataset a batch shows; only the first call does anything.

        Args:
            rows: ``(B,)`` int64 absolute frame indices.
            images: ``(B, 3, h, w)`` bytes, or floats in [0, 1]: what the batch holds of the workspace camera.

        Raises:
            CheckpointError: No camera of the dataset shows these images.
            DatasetError: Frames are damaged.
        """
        if self._frames is not None:
            return
        rows, shown = rows[:COMPARED], images[:COMPARED].detach().cpu()
        shown = scale_images(as_floats(shown) if shown.dtype == torch.uint8 else shown.float(), self._size)
        errors: dict[tuple[str, str | None], float] = {}
        for camera, backend in self._candidates():
            errors[camera, backend] = self._difference(camera, backend, rows, shown)
            if errors[camera, backend] == 0:
                break
        camera, backend = self._nearest(errors)
        if camera != self._camera:
            logger.info("the batch's %r is the dataset's %r: goal images are taken from there", self._camera, camera)
        dataset = LocalDataset(self._root, video_backend=backend)
        self._frames = cached_frames(dataset, camera, size=self._size)

    def __getitem__(self, frames: IntArray) -> NDArray[np.uint8]:
        """Loads images ``(B, 3, h, w)`` of absolute frame indices ``(B,)``, after `recognise`."""
        if self._frames is None:
            raise ValueError("the workspace camera has not been recognised yet")
        images: NDArray[np.uint8] = self._frames[frames]
        return images

    def _candidates(self) -> Iterator[tuple[str, str | None]]:
        """Lists cameras and decoders, the most likely first: the camera of this name, LeRobot's default decoder."""
        dataset = LocalDataset(self._root)
        features = dataset.features
        alike = [c for c in dataset.cameras if frame_size(features[c], c) == self._stored]
        for camera in sorted(alike, key=lambda name: name != self._camera):
            is_video = features[camera]["dtype"] == "video"
            yield from ((camera, backend) for backend in ((None, "pyav") if is_video else (None,)))

    def _difference(self, camera: str, backend: str | None, rows: IntArray, shown: Tensor) -> float:
        episodes = tuple((np.searchsorted(self._starts, rows, side="right") - 1).tolist())
        dataset = LocalDataset(self._root, chosen=episodes, video_backend=backend)
        frames = as_floats(torch.from_numpy(cached_frames(dataset, camera, size=self._size)[rows]))
        return float((frames - shown).abs().mean())

    def _nearest(self, errors: dict[tuple[str, str | None], float]) -> tuple[str, str | None]:
        if not errors:
            raise CheckpointError(
                f"{self._root} has no RGB camera of {self._stored[0]} x {self._stored[1]} pixels, which the policy was "
                f"made for ({self._camera!r})."
            )
        nearest = min(errors, key=errors.__getitem__)
        if errors[nearest] == 0:
            return nearest
        others = [error for (camera, _), error in errors.items() if camera != nearest[0]]
        if others and errors[nearest] > CLEARLY * min(others):
            if self._camera not in {camera for camera, _ in errors}:
                raise CheckpointError(
                    f"Which camera of {self._root} the batch calls {self._camera!r} cannot be told: its images are "
                    f"none of the dataset's own (mean differences: {errors}). Leave out dataset.image_transforms, or "
                    "rename the cameras in the dataset."
                )
            nearest = (self._camera, None)
        logger.warning(
            "The batch's images are not the dataset's own pixels (image transforms?); goal images of %r stay plain.",
            nearest[0],
        )
        return nearest
