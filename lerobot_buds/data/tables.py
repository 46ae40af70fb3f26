"""Reads the numeric columns of a LeRobotDataset on disk, without torch and without LeRobot.

Every array is in the order of the absolute frame ``index``, so that rows of subsets and of partial downloads keep their
place.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import TRUE_STAGE, DatasetError, IntArray

from .dataset import AnyDataset, LocalDataset


@dataclass(frozen=True)
class FrameTable:
    """Columns of the frames of a dataset.

    Attributes:
        root: Folder of the dataset.
        fps: Frame rate (frames per second).
        numbers: ``(E,)`` numbers of the chosen episodes.
        starts: ``(E,)`` absolute index of every chosen episode's first frame.
        ends: ``(E,)`` one past every chosen episode's last frame, so an episode is ``[start, end)``.
        columns: Name to ``(N, ...)`` array in the order of the absolute ``index`` of the whole dataset; scalar features
            are ``(N,)``. Where a row is not there, floats hold NaN, signed integers -1, and other types, which have no
            value to spare, 0.
        present: ``(N,)`` rows that exist locally and belong to chosen episodes.
    """

    root: Path
    fps: float
    numbers: IntArray
    starts: IntArray
    ends: IntArray
    columns: dict[str, NDArray[Any]]
    present: NDArray[np.bool_]

    @property
    def n_episodes(self) -> int:
        """Number of chosen episodes."""
        return len(self.starts)

    @cached_property
    def rows(self) -> IntArray:
        """Absolute indices of all frames of the chosen episodes, ``(M,)``, in ascending order."""
        lengths = self.ends - self.starts
        rows: IntArray = np.arange(lengths.sum()) + np.repeat(self.ends - np.cumsum(lengths), lengths)
        return rows

    def locate(self, index: int) -> str:
        """Names a frame for messages, for example ``"episode 3, frame 17"``.

        Args:
            index: Absolute index of a frame of a chosen episode.
        """
        episode = int(np.searchsorted(self.ends, index, side="right"))
        return f"episode {self.numbers[episode]}, frame {index - int(self.starts[episode])}"


def read_table(dataset: AnyDataset, columns: Sequence[str]) -> FrameTable:
    """Reads columns of the chosen frames of a dataset.

    Args:
        dataset: What stands for the dataset.
        columns: Names of numeric features of rank 1; a feature of shape ``(1,)`` comes back as ``(N,)``.

    Raises:
        DatasetError: The dataset is damaged, or lacks a column (all missing ones are named).
    """
    local = LocalDataset.of(dataset)
    local.require(columns)
    total = local.total_frames
    present = np.zeros(total, dtype=np.bool_)
    arrays = {name: _blank(name, local.features[name], total) for name in columns}
    for shard in local.shards(columns):
        index = shard["index"].to_numpy()
        if len(index) and (
            index.min() < 0 or index.max() >= total or present[index].any() or len(np.unique(index)) < len(index)
        ):
            raise DatasetError(
                f"{local.root / 'data'}: frame indices {index.min()} to {index.max()} repeat rows, or leave "
                f"[0, {total}). Old data files may have been left behind; fetch the dataset again into an empty folder."
            )
        present[index] = True
        for name, array in arrays.items():
            values = shard[name].combine_chunks()
            flat = values.flatten() if array.ndim == 2 else values
            array[index] = flat.to_numpy(zero_copy_only=False).reshape(-1, *array.shape[1:])
    table = FrameTable(local.root, local.fps, *_places(local.episodes), arrays, present)
    if local.chosen is not None:
        others = np.ones(total, dtype=np.bool_)
        others[table.rows] = False
        present[others] = False
    return table


def true_stages(dataset: AnyDataset) -> list[IntArray]:
    """Reads the true stage of every frame, ``(T,)`` per chosen demonstration.

    Raises:
        DatasetError: The dataset is damaged, or has no column ``true_stage``.
    """
    table = read_table(dataset, [TRUE_STAGE])
    column = table.columns[TRUE_STAGE]
    return [column[start:end] for start, end in zip(table.starts, table.ends, strict=True)]


def _places(records: Sequence[Mapping[str, Any]]) -> tuple[IntArray, IntArray, IntArray]:
    """Collects number, first frame and end of every episode, ``(E,)`` each."""
    keys = ("episode_index", "dataset_from_index", "dataset_to_index")
    places = np.array([[record[key] for key in keys] for record in records], dtype=np.int64).reshape(-1, 3)
    return places[:, 0], places[:, 1], places[:, 2]


def _blank(name: str, feature: Mapping[str, Any], total: int) -> NDArray[Any]:
    shape = tuple(feature["shape"])
    if feature["dtype"] in ("video", "image", "string") or len(shape) != 1:
        raise DatasetError(f"column {name!r} of type {feature['dtype']} and shape {shape} is no numeric vector.")
    dtype = np.dtype(feature["dtype"])
    fill = {"f": np.nan, "i": -1}.get(dtype.kind, 0)
    return np.full((total,) if shape == (1,) else (total, *shape), fill, dtype=dtype)
