"""Reads the numeric columns and the episode records of a LeRobotDataset on disk, without torch and without LeRobot.

Every array is in the order of the absolute frame ``index``, so that rows of partial downloads keep their place.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_buds.core import DatasetError, IntArray, near_names, read_json

FPS_RANGE = (1, 1000)
"""Control rates outside are a mistake of the recorder (frames per second)."""

_INFO_KEYS = ("fps", "features", "total_frames", "data_path")


@dataclass(frozen=True)
class FrameTable:
    """Columns of all frames of a dataset.

    Attributes:
        root: Folder of the dataset.
        fps: Frame rate (frames per second).
        starts: ``(E,)`` absolute index of every episode's first frame.
        ends: ``(E,)`` one past every episode's last frame, so an episode is ``[start, end)``.
        columns: Name to ``(N, ...)`` array in the order of the absolute ``index``; scalar features are ``(N,)``.
        present: ``(N,)`` rows that exist locally; where a partial download lacks one, integers hold -1 and floats NaN.
    """

    root: Path
    fps: float
    starts: IntArray
    ends: IntArray
    columns: dict[str, NDArray[Any]]
    present: NDArray[np.bool_]

    @property
    def n_episodes(self) -> int:
        """Number of episodes."""
        return len(self.starts)

    def locate(self, index: int) -> str:
        """Names a frame for messages, for example ``"episode 3, frame 17"``.

        Args:
            index: Absolute index of the frame.
        """
        episode = int(np.searchsorted(self.ends, index, side="right"))
        return f"episode {episode}, frame {index - int(self.starts[episode])}"


class DatasetFiles:
    """What the metadata of a LeRobotDataset (format v3) says about its files; reads lazily, changes nothing.

    Args:
        root: Folder of the dataset.
    """

    def __init__(self, root: Path) -> None:
        self.root = Path(root)

    @cached_property
    def info(self) -> dict[str, Any]:
        """Content of ``meta/info.json``.

        Raises:
            DatasetError: The file is missing or no JSON, or describes another format than v3.
        """
        path = self.root / "meta/info.json"
        try:
            info: dict[str, Any] = read_json(path)
        except FileNotFoundError as error:
            raise DatasetError(f"{self.root} is no LeRobotDataset: {path} does not exist.") from error
        except json.JSONDecodeError as error:
            raise DatasetError(f"{path} is damaged ({error}); download or record the dataset again.") from error
        absent = [key for key in _INFO_KEYS if key not in info]
        if absent:
            raise DatasetError(f"{path} is damaged (no {absent}); download or record the dataset again.")
        version = str(info.get("codebase_version", "unknown"))
        if not version.startswith("v3."):
            raise DatasetError(
                f"{path}: dataset format {version} is not v3; convert it with LeRobot's own tools first."
            )
        return info

    @property
    def features(self) -> dict[str, dict[str, Any]]:
        """The dataset's features by name, each with ``dtype``, ``shape`` and ``names``."""
        features: dict[str, dict[str, Any]] = self.info["features"]
        return features

    @property
    def fps(self) -> float:
        """Frame rate (frames per second), exactly as it is stored.

        Raises:
            DatasetError: It is outside `FPS_RANGE`.
        """
        fps: float = self.info["fps"]
        if not FPS_RANGE[0] <= fps <= FPS_RANGE[1]:
            raise DatasetError(f"{self.root}/meta/info.json: fps={fps} is outside {FPS_RANGE}; correct it.")
        return fps

    @property
    def total_frames(self) -> int:
        """Number of frames of the whole dataset, downloaded or not."""
        return int(self.info["total_frames"])

    @cached_property
    def episodes(self) -> list[dict[str, Any]]:
        """One record per episode, by episode number: frame range, data file and video file of each camera.

        Raises:
            DatasetError: The records are damaged, or do not tile ``[0, total_frames)``.
        """
        records: list[dict[str, Any]] = []
        for path in sorted((self.root / "meta/episodes").glob("*/*.parquet")):
            try:
                names = [n for n in pq.read_schema(path).names if not n.startswith("stats/")]
                records += pq.read_table(path, columns=names).to_pylist()
            except (pa.ArrowException, OSError) as error:
                raise DatasetError(f"{path} is damaged ({error}); download or record the dataset again.") from error
        records.sort(key=lambda record: int(record["episode_index"]))
        expected = 0
        for number, record in enumerate(records):
            if int(record["episode_index"]) != number or int(record["dataset_from_index"]) != expected:
                raise DatasetError(
                    f"{self.root / 'meta/episodes'}: episode {number} should start at index {expected}, but the next "
                    f"record is episode {record['episode_index']} at {record['dataset_from_index']}. A file is missing."
                )
            expected = int(record["dataset_to_index"])
        if expected != self.total_frames:
            raise DatasetError(
                f"{self.root / 'meta'}: the episode records hold {expected} frames, info.json {self.total_frames}. "
                "Recording was not finished, or a file is missing."
            )
        return records

    def data_path(self, record: dict[str, Any]) -> Path:
        """Path of the parquet file that holds an episode's rows."""
        pattern: str = self.info["data_path"]
        return self.root / pattern.format(chunk_index=record["data/chunk_index"], file_index=record["data/file_index"])

    def video_path(self, record: dict[str, Any], camera: str) -> Path:
        """Path of the video file that holds an episode's frames of one camera."""
        pattern: str = self.info["video_path"]
        return self.root / pattern.format(
            video_key=camera,
            chunk_index=record[f"videos/{camera}/chunk_index"],
            file_index=record[f"videos/{camera}/file_index"],
        )

    def require(self, names: Sequence[str]) -> None:
        """Refuses a dataset that lacks any of the named features, naming all missing ones at once.

        Raises:
            DatasetError: At least one feature is missing.
        """
        missing = [name for name in names if name not in self.features]
        if missing:
            lines = "\n".join(f"  {name!r}: {near_names(name, self.features)}" for name in missing)
            raise DatasetError(
                f"{self.root} lacks {len(missing)} required feature(s); name others in the settings, or record them:"
                f"\n{lines}"
            )

    def shards(self, columns: Sequence[str]) -> Iterator[pa.Table]:
        """Reads the local parquet files one after the other.

        Args:
            columns: Names of the columns to read.

        Yields:
            Tables with the column ``index`` and those asked for.

        Raises:
            DatasetError: A file is truncated or damaged (named with its episodes), or no file is there.
        """
        names = ["index", *(name for name in columns if name != "index")]
        paths = dict.fromkeys(self.data_path(record) for record in self.episodes)
        local = [path for path in paths if path.exists()]
        if paths and not local:
            raise DatasetError(f"{self.root / 'data'} holds no rows: download the data files of the dataset first.")
        for path in local:
            try:
                yield pq.read_table(path, columns=names)
            except (pa.ArrowException, OSError) as error:
                inside = [i for i, record in enumerate(self.episodes) if self.data_path(record) == path]
                raise DatasetError(
                    f"{path} cannot be read ({error}). It holds episodes {inside[0]} to {inside[-1]}; it was probably "
                    "cut off while copying: fetch it again, or remove these episodes with lerobot-edit-dataset."
                ) from error


def read_table(root: Path, columns: Sequence[str]) -> FrameTable:
    """Reads columns of all frames of a dataset.

    Args:
        root: Folder of a LeRobotDataset, format v3.
        columns: Names of numeric features of rank 1; a feature of shape ``(1,)`` comes back as ``(N,)``.

    Raises:
        DatasetError: The dataset is damaged, or lacks a column (all missing ones are named).
    """
    files = DatasetFiles(root)
    files.require(columns)
    total = files.total_frames
    present = np.zeros(total, dtype=np.bool_)
    arrays = {name: _blank(name, files.features[name], total) for name in columns}
    for shard in files.shards(columns):
        index = shard["index"].to_numpy()
        if len(index) and (
            index.min() < 0 or index.max() >= total or present[index].any() or len(np.unique(index)) < len(index)
        ):
            raise DatasetError(
                f"{files.root / 'data'}: frame indices {index.min()} to {index.max()} repeat rows, or leave "
                f"[0, {total}). Old data files may have been left behind; fetch the dataset again into an empty folder."
            )
        present[index] = True
        for name, array in arrays.items():
            values = shard[name].combine_chunks()
            flat = values.flatten() if array.ndim == 2 else values
            array[index] = flat.to_numpy(zero_copy_only=False).reshape(-1, *array.shape[1:])
    bounds = np.array([[r["dataset_from_index"], r["dataset_to_index"]] for r in files.episodes], dtype=np.int64)
    starts, ends = bounds.reshape(-1, 2).T
    return FrameTable(files.root, files.fps, starts, ends, arrays, present)


def _blank(name: str, feature: dict[str, Any], total: int) -> NDArray[Any]:
    shape = tuple(feature["shape"])
    if feature["dtype"] in ("video", "image", "string") or len(shape) != 1:
        raise DatasetError(f"column {name!r} of type {feature['dtype']} and shape {shape} is no numeric vector.")
    dtype = np.dtype(feature["dtype"])
    fill = np.nan if dtype.kind == "f" else False if dtype.kind == "b" else -1
    return np.full((total,) if shape == (1,) else (total, *shape), fill, dtype=dtype)
