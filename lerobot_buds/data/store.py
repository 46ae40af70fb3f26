"""The frame store: a bounded folder of arrays that can be made again, each named by its content.

An array is filled episode by episode. What is finished is noted beside it, so that a killed call goes on where it was,
and a call that needs other episodes adds to what is there. The least recently used arrays make room for new ones.
"""

import json
import logging
import os
import shutil
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.utils.constants import HF_LEROBOT_HOME
from numpy.typing import NDArray

from lerobot_buds.core import ConfigError, DatasetError, StorageError, read_json, write_json

from .writing import only_writer

logger = logging.getLogger(__name__)

LIMIT_VARIABLE = "BUDS_STORE_LIMIT"
"""Environment variable that bounds the store: a share of its disk (``30%``) or a size (``200GB``)."""

DEFAULT_LIMIT = "20%"
_UNITS = {"B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}


@dataclass(frozen=True)
class FrameStore:
    """The arrays of one folder, and the bound on their size.

    Attributes:
        folder: Where they lie.
        limit_bytes: What they may take on disk together (bytes).
    """

    folder: Path
    limit_bytes: int

    @classmethod
    def open(cls, folder: Path | None = None) -> "FrameStore":
        """Opens a store; nothing is created.

        Args:
            folder: Its folder; ``$HF_LEROBOT_HOME/buds_cache`` where None.

        Raises:
            ConfigError: ``BUDS_STORE_LIMIT`` is neither a share nor a size.
        """
        place = folder or HF_LEROBOT_HOME / "buds_cache"
        return cls(place, _limit(os.environ.get(LIMIT_VARIABLE, DEFAULT_LIMIT), place))

    def used_bytes(self) -> int:
        """Adds up what the arrays take on disk (bytes); frames that were not decoded yet take nothing."""
        return sum(_disk_bytes(path) for path in self.arrays())

    def arrays(self) -> list[Path]:
        """Lists the arrays, the least recently used first."""
        return sorted(self.folder.glob("*.npy"), key=_used_at)

    def describe(self, path: Path) -> str:
        """Says in words what an array holds, as far as is known."""
        return str(_note(path).get("what", "latents" if path.name.startswith("latents-") else "unknown"))

    def clear(self) -> int:
        """Removes all arrays, whose readers keep what they have open, and returns the bytes that were freed."""
        freed = self.used_bytes()
        for path in self.arrays():
            _remove(path)
        return freed

    def reserve(self, path: Path, needed: int) -> None:
        """Makes room for a new or growing array by removing the least recently used others that nobody is filling.

        Args:
            path: The array.
            needed: What is going to be written (bytes).

        Raises:
            StorageError: It would not fit into the bound or onto the disk even alone.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        others = [other for other in self.arrays() if other != path]
        used, free = self.used_bytes(), shutil.disk_usage(self.folder).free
        while others and (used + needed > self.limit_bytes or needed > free):
            oldest = others.pop(0)
            size, what = _disk_bytes(oldest), self.describe(oldest)
            try:
                with only_writer(oldest):
                    _remove(oldest)
            except DatasetError:
                continue  # another process is filling it
            logger.info("%s makes room in the frame store: %s, %d bytes", oldest, what, size)
            used, free = used - size, free + size
        if used + needed > self.limit_bytes:
            raise StorageError(
                f"{path} needs {needed:,} bytes, but the frame store {self.folder} may hold {self.limit_bytes:,}. "
                f"Raise {LIMIT_VARIABLE} (for example 200GB), or use a smaller image_size or fewer episodes."
            )
        if needed > free:
            raise StorageError(
                f"{path} needs {needed:,} bytes, but only {free:,} are free in {self.folder}; make room, or set "
                "HF_LEROBOT_HOME to a larger disk."
            )


class EpisodeArray:
    """An array on disk that is filled episode by episode; only the holder of its lock may write.

    Args:
        path: Its file; what is finished is noted in a JSON file beside it.
        shape: ``(N, ...)``, a row for every frame of the dataset.
        dtype: Type of its numbers.
        what: What it holds, in words.
    """

    def __init__(self, path: Path, shape: tuple[int, ...], dtype: type[np.generic], what: str) -> None:
        self.path, self.shape, self.dtype, self._what = path, shape, np.dtype(dtype), what
        self.row_bytes = int(np.prod(shape[1:], dtype=np.int64)) * self.dtype.itemsize
        self._offset = 0

    def finished(self) -> set[int]:
        """Numbers of the episodes that are there; none where the array is missing or of another shape."""
        note = _note(self.path)
        if not self.path.exists() or note.get("shape") != list(self.shape) or note.get("dtype") != self.dtype.str:
            return set()
        return set(note["episodes"])

    def read(self) -> NDArray[Any]:
        """Maps the array into memory, read-only, and marks it as used."""
        # File systems note the time of reading seldom, and never that of a read through a map.
        os.utime(self.path, (time.time(), self.path.stat().st_mtime))
        array: NDArray[Any] = np.load(self.path, mmap_mode="r", allow_pickle=False)
        return array

    def create(self) -> None:
        """Lays out the file without its content, unless it is there already; holes take no room on the disk."""
        if not self.finished():
            _remove(self.path)
            np.lib.format.open_memmap(self.path, "w+", self.dtype, self.shape)  # type: ignore[no-untyped-call]
        self._offset = np.load(self.path, mmap_mode="r", allow_pickle=False).offset

    def write(self, start: int, rows: NDArray[Any]) -> None:
        """Writes rows from a row on, after `create`; as a file, since a full disk kills who writes to a map."""
        with self.path.open("r+b") as file:
            file.seek(self._offset + start * self.row_bytes)
            file.write(np.ascontiguousarray(rows, dtype=self.dtype).data)

    def remove(self) -> None:
        """Removes the array with all that is finished."""
        _remove(self.path)

    def finish(self, episodes: Iterable[int]) -> None:
        """Notes that episodes are there, which must have been written; from then on a kill does not lose them."""
        with self.path.open("rb") as file:
            os.fsync(file.fileno())
        done = sorted(self.finished() | set(episodes))
        note = {"what": self._what, "shape": list(self.shape), "dtype": self.dtype.str, "episodes": done}
        write_json(_note_path(self.path), note)


def _note_path(path: Path) -> Path:
    return path.with_suffix(".json")


def _note(path: Path) -> Mapping[str, Any]:
    try:
        note = read_json(_note_path(path))
    except (FileNotFoundError, json.JSONDecodeError):
        return {}
    return note if isinstance(note, dict) else {}


def _remove(path: Path) -> None:
    # The note first: an array without one counts as empty.
    _note_path(path).unlink(missing_ok=True)
    path.unlink(missing_ok=True)


def _used_at(path: Path) -> int:
    try:
        return path.stat().st_atime_ns
    except FileNotFoundError:  # another process has removed it meanwhile
        return 0


def _disk_bytes(path: Path) -> int:
    try:
        return path.stat().st_blocks * 512
    except FileNotFoundError:
        return 0


def _limit(text: str, folder: Path) -> int:
    value = text.strip().upper()
    try:
        if value.endswith("%"):
            share = float(value[:-1]) / 100
            existing = next(place for place in (folder, *folder.parents) if place.exists())
            limit = share * shutil.disk_usage(existing).total
        else:
            digits = value.rstrip("KMGTB")
            limit = float(digits) * _UNITS[value[len(digits) :] or "B"]
        if not limit > 0:
            raise ValueError(text)
    except (KeyError, ValueError) as error:
        raise ConfigError(
            f"{LIMIT_VARIABLE}={text!r} is neither a share of the disk, such as 20%, nor a size, such as 200GB."
        ) from error
    return int(limit)
