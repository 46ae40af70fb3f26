"""Reads demonstrations whose observations are stored as arrays, checked as a whole before the first frame is read."""

from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import ACTION, IMAGE_PREFIX, STATE, TRUE_STAGE, DatasetError
from lerobot_buds.envs import ACTION_NAMES

from .layout import Layout, Stages, data_of
from .rows import Rows, rows_of, state_of
from .source import Source
from .told import told_by


class StoredDemonstrations:
    """The demonstrations of an open file whose arrays hold what was observed; see `Demonstrations`.

    Args:
        file: The file, open for reading.
        layout: Its layout.
        source: What to read of it.

    Raises:
        ConfigError: A setting does not go with the layout.
        DatasetError: Arrays are missing (all are named), of unequal lengths or of the wrong kind; values are not
            finite; the file does not say how its images lie.
    """

    def __init__(self, file: h5py.File, layout: Layout, source: Source) -> None:
        self._source, self._layout = source, layout
        self.layout = layout.name
        self._rows = rows_of(file, layout, source)
        self._check_kinds()
        self._state = state_of(layout, source)
        self.lengths = {name: rows[ACTION].stop - rows[ACTION].start for name, rows in self._rows.items()}
        first = next(iter(self._rows.values()))
        names = layout.names
        self.action_names = names_of("action", ACTION_NAMES, self._vector(first[ACTION]))
        self.state_names = [n for k in self._state for n in names_of(k, names.get(k), self._part(first, k))]
        data = data_of(file, source.path)
        self._orientation = self._orient(data, first)
        self.image_shapes = {
            key: self._images(rows._replace(stop=rows.start + 1)).shape[1:]
            for key, rows in first.items()
            if key.startswith(IMAGE_PREFIX)
        }
        told = told_by(data, list(self._rows), source)
        self.fps, self.environment, self.instructions = told.fps, told.environment, told.instructions
        self._stages = layout.stages(data, list(self._rows)) if layout.stages else Stages((), {})
        self.stages = self._stages.names
        self.facts: dict[str, Any] = {"orientation": self._orientation}
        for name in self.lengths:
            self._vectors(name)

    def read(self, name: str) -> dict[str, NDArray[Any]]:
        """Reads one demonstration; see `Demonstrations.read`."""
        rows = self._rows[name]
        columns = {**self._vectors(name), **{key: self._images(rows[key]) for key in self.image_shapes}}
        if self._stages.names:
            actions = rows[ACTION]
            columns[TRUE_STAGE] = self._stages.of[name][actions.start : actions.stop, None]
        return columns

    def _orient(self, data: h5py.Group, first: dict[str, Rows]) -> str:
        """Settles how images are turned; where nobody says it and there are some, refuses to guess."""
        told = self._source.orientation or self._layout.orientation(data)
        if told is None and any(key.startswith(IMAGE_PREFIX) for key in first):
            raise DatasetError(
                f"{self._source.path} looks like the {self.layout} layout, but does not say how its images lie (no "
                "attribute macros_image_convention, 'opengl' or 'opencv'). Look at one and say it with "
                "--orientation=stored, flipped or rotated; and if observations were stored before their action, not "
                "after it as in files of LIBERO's own, with --alignment=released."
            )
        return told or "stored"

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
        vectors = {ACTION: (self._vector(rows[ACTION]), self.action_names)}
        if self._state:
            state = np.concatenate([self._part(rows, key) for key in self._state], axis=1)
            vectors[STATE] = (state, self.state_names)
        for feature, (values, names) in vectors.items():
            require_finite_rows(values, names, f"{self._source.path}: {feature!r}", name)
        return {feature: values for feature, (values, _) in vectors.items()}

    def _part(self, rows: dict[str, Rows], key: str) -> NDArray[np.float32]:
        return self._vector(rows[key])[:, : self._layout.leading.get(key)]

    def _vector(self, rows: Rows) -> NDArray[np.float32]:
        return read_rows(rows, self._source).astype(np.float32)

    def _images(self, rows: Rows) -> NDArray[np.uint8]:
        images = read_rows(rows, self._source)
        images = images if images.shape[-1] == 3 else images.transpose(0, 2, 3, 1)
        if self._orientation == "flipped":
            return images[:, ::-1]
        return images[:, ::-1, ::-1] if self._orientation == "rotated" else images


def read_rows(rows: Rows, source: Source) -> NDArray[Any]:
    """Reads rows of an array.

    Raises:
        DatasetError: The file is damaged inside.
    """
    try:
        values: NDArray[Any] = rows.array[rows.start : rows.stop]
    except OSError as error:
        raise DatasetError(f"{source.path}: {rows.array.name} is damaged ({error}); fetch it again.") from error
    return values


def require_finite_rows(values: NDArray[Any], names: list[str], what: str, demonstration: str) -> None:
    """Refuses NaN and infinities in ``(T, D)`` values.

    Raises:
        DatasetError: Names demonstration, frame and dimension of the first one.
    """
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        frame, dim = bad[0].tolist()
        raise DatasetError(
            f"{what} is {values[frame, dim]} in {demonstration}, frame {frame}, dimension {dim} ({names[dim]!r}). "
            "Repair the recording, or select others with --filter_key."
        )


def names_of(key: str, names: list[str] | None, values: NDArray[Any]) -> list[str]:
    """Names the dimensions of ``(T, D)`` values: as given where these are D names, else by a key and numbers."""
    width = values.shape[1]
    return names if names and len(names) == width else [f"{key}_{dim}" for dim in range(width)]
