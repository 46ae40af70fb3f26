"""Reads demonstrations from HDF5 files, opened read-only and checked as a whole before the first frame is read."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import ACTION, IMAGE_PREFIX, STATE, DatasetError
from lerobot_buds.envs import ACTION_NAMES

from .hdf5_layouts import Rows, Source, layout_of, rows_of


@contextmanager
def open_demonstrations(source: Source) -> Iterator["Demonstrations"]:
    """Opens a file and checks all of it but the values of its pixels.

    Raises:
        ConfigError: The layout or the alignment is unknown, or they do not go together.
        DatasetError: The file is missing, cut off or in no known layout; arrays are missing (all are named), of unequal
            lengths or of the wrong kind; values are not finite.
    """
    if not source.path.is_file():
        raise DatasetError(f"{source.path} does not exist; name the HDF5 file with --source.")
    try:
        file = h5py.File(source.path, "r")
    except OSError as error:
        raise DatasetError(
            f"{source.path} cannot be opened ({error}). It is no HDF5 file, or was cut off: fetch it again."
        ) from error
    with file:
        yield Demonstrations(file, source)


class Demonstrations:
    """The demonstrations of an open file as LeRobot wants them: a row pairs an observation with the action after it.

    Attributes:
        layout: The file's layout.
        lengths: Number of frames by the demonstration's name in the file, in the order of their numbers.
        state_names: One name a dimension of the state: those of our own environments where the arrays are the layout's.
        action_names: One name a dimension of the action.
        image_shapes: Image feature -> ``(H, W, 3)``.
    """

    def __init__(self, file: h5py.File, source: Source) -> None:
        self._source = source
        self.layout = layout_of(file, source)
        self._rows = rows_of(file, self.layout, source)
        self._check_kinds()
        self._state = list(source.state or self.layout.state)
        self.lengths = {name: rows[ACTION].stop - rows[ACTION].start for name, rows in self._rows.items()}
        first = next(iter(self._rows.values()))
        self.action_names = _names_of("action", ACTION_NAMES, self._vector(first[ACTION]))
        usual = self.layout.state
        self.state_names = [n for k in self._state for n in _names_of(k, usual.get(k), self._part(first, k))]
        self.image_shapes = {
            key: self._images(rows._replace(stop=rows.start + 1)).shape[1:]
            for key, rows in first.items()
            if key.startswith(IMAGE_PREFIX)
        }
        for name in self.lengths:
            self._vectors(name)

    def read(self, name: str) -> dict[str, NDArray[Any]]:
        """Reads one demonstration.

        Args:
            name: Its name, a key of `lengths`.

        Returns:
            One row a frame, by the names of the dataset's features: ``action`` and ``observation.state`` float32, and
            uint8 RGB images ``(T, H, W, 3)``, top row first.

        Raises:
            DatasetError: The file is damaged inside.
        """
        return {**self._vectors(name), **{key: self._images(self._rows[name][key]) for key in self.image_shapes}}

    def _check_kinds(self) -> None:
        first = next(iter(self._rows.values()))
        for rows in self._rows.values():
            for key, (array, _, _) in rows.items():
                if key.startswith(IMAGE_PREFIX):
                    wanted = "uint8 RGB images"
                    good = array.dtype == np.uint8 and array.ndim == 4 and 3 in (array.shape[1], array.shape[3])
                else:
                    wanted = "rows of numbers"
                    good = array.dtype.kind in "fiu" and array.ndim == 2
                if not good or array.shape[1:] != first[key].array.shape[1:]:
                    raise DatasetError(
                        f"{self._source.path}: {array.name} is of type {array.dtype} and shape {array.shape}; wanted "
                        f"are {wanted}, of one size in all demonstrations. Name another array, or repair the file."
                    )

    def _vectors(self, name: str) -> dict[str, NDArray[Any]]:
        rows = self._rows[name]
        state = np.concatenate([self._part(rows, key) for key in self._state], axis=1)
        vectors = {STATE: (state, self.state_names), ACTION: (self._vector(rows[ACTION]), self.action_names)}
        for feature, (values, names) in vectors.items():
            bad = np.argwhere(~np.isfinite(values))
            if len(bad):
                frame, dim = bad[0].tolist()
                raise DatasetError(
                    f"{self._source.path}: {feature!r} is {values[frame, dim]} in {name}, frame {frame}, dimension "
                    f"{dim} ({names[dim]!r}). Repair the recording, or select others with --filter_key."
                )
        return {feature: values for feature, (values, _) in vectors.items()}

    def _part(self, rows: dict[str, Rows], key: str) -> NDArray[np.float32]:
        return self._vector(rows[key])[:, : self.layout.leading.get(key)]

    def _vector(self, rows: Rows) -> NDArray[np.float32]:
        return self._read(rows).astype(np.float32)

    def _images(self, rows: Rows) -> NDArray[np.uint8]:
        images = self._read(rows)
        images = images if images.shape[-1] == 3 else images.transpose(0, 2, 3, 1)
        return images[:, ::-1] if self._source.flip else images

    def _read(self, rows: Rows) -> NDArray[Any]:
        try:
            values: NDArray[Any] = rows.array[rows.start : rows.stop]
        except OSError as error:
            raise DatasetError(
                f"{self._source.path}: {rows.array.name} is damaged ({error}); fetch it again."
            ) from error
        return values


def _names_of(key: str, names: list[str] | None, values: NDArray[Any]) -> list[str]:
    width = values.shape[1]
    return names if names and len(names) == width else [f"{key}_{dim}" for dim in range(width)]
