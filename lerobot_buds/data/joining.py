"""Joins parts, datasets of one episode each, into one dataset, without encoding anything again.

Rows are renumbered and copied, one row group an episode; videos are put one behind the other once a file is full.
LeRobot's own `aggregate_datasets` needs all parts before it begins, embeds every image again, and copies for every part
what is there already.
"""

import shutil
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_buds.core import read_json

from .dataset import LocalDataset
from .writing import sort_stats

_MIB = 2**20


def join_parts(parts: Iterable[Path], repo_id: str, root: Path) -> list[int]:
    """Joins parts in the order in which they come, each as soon as it does.

    Args:
        parts: Folders of at least one dataset of one episode each, all with the same features and rate.
        repo_id: Name of the dataset.
        root: Its folder, which must not exist.

    Returns:
        Frames of each episode.

    Raises:
        DatasetError: A part is damaged.
    """
    coming = iter(parts)
    first = next(coming)
    joined = _Joined(LocalDataset(first), repo_id, root)
    lengths = [joined.append(LocalDataset(part)) for part in chain([first], coming)]
    joined.close()
    sort_stats(root)
    return lengths


class _Joined:
    """A dataset to which parts are appended."""

    def __init__(self, first: LocalDataset, repo_id: str, root: Path) -> None:
        from lerobot.datasets import LeRobotDatasetMetadata

        sizes = {name: first.info[name] for name in ("chunks_size", "data_files_size_in_mb", "video_files_size_in_mb")}
        video = any(feature["dtype"] == "video" for feature in first.features.values())
        meta = LeRobotDatasetMetadata.create(
            repo_id, first.info["fps"], first.features, first.info["robot_type"], root, use_videos=video, **sizes
        )
        self._meta = meta
        self._rows = _Rows(_Files(root, meta.data_path, meta.data_files_size_in_mb, meta.chunks_size))
        self._videos = {
            camera: _Videos(_Files(root, meta.video_path, meta.video_files_size_in_mb, meta.chunks_size, camera))
            for camera in meta.video_keys
        }

    def append(self, part: LocalDataset) -> int:
        """Appends a part and returns its number of frames."""
        from lerobot.datasets import DEFAULT_QUANTILES, get_feature_stats

        meta, (record,) = self._meta, part.episodes
        (task,), length = record["tasks"], int(record["length"])
        meta.save_episode_tasks([task])
        episode, start = meta.total_episodes, meta.total_frames
        numbers = {
            "episode_index": np.full(length, episode),
            "index": np.arange(start, start + length),
            "task_index": np.full(length, meta.get_task_index(task)),
        }
        stats = _stats_of(part) | {
            name: get_feature_stats(values, axis=0, keepdims=True, quantile_list=DEFAULT_QUANTILES)
            for name, values in numbers.items()
        }
        where = self._rows.append(part.data_path(record), numbers)
        where |= {"dataset_from_index": start, "dataset_to_index": start + length}
        for camera, videos in self._videos.items():
            where |= videos.append(part.video_path(record, camera), record[f"videos/{camera}/to_timestamp"])
        meta.save_episode(episode, length, [task], stats, where)
        return length

    def close(self) -> None:
        self._rows.close()
        for videos in self._videos.values():
            videos.close()
        self._meta.finalize()


def _stats_of(part: LocalDataset) -> dict[str, dict[str, Any]]:
    stats = read_json(part.root / "meta/stats.json")
    return {name: {key: np.array(value) for key, value in of_one.items()} for name, of_one in stats.items()}


@dataclass
class _Files:
    """Files of one kind, of which one is filled after the other.

    Attributes:
        root: The dataset's folder.
        pattern: Path of a file below it, by the numbers of its folder and itself, and by its camera.
        limit: Size at which the next one is begun (MiB).
        per_folder: Files of one folder.
        camera: The camera of which they are.
    """

    root: Path
    pattern: str
    limit: float
    per_folder: int
    camera: str = ""
    _number: int = 0
    _filled: float = 0.0

    def take(self, path: Path) -> bool:
        """Counts a file's content in, and says whether that begins the next file."""
        size = path.stat().st_size / _MIB
        full = self._filled > 0 and self._filled + size >= self.limit
        self._number += full
        self._filled = size if full else self._filled + size
        return full

    @property
    def place(self) -> dict[str, int]:
        """Where the present file is, as LeRobot records it."""
        folder, number = divmod(self._number, self.per_folder)
        return {"chunk_index": folder, "file_index": number}

    def path(self) -> Path:
        """Makes the present file's folder and returns the file's path."""
        path = self.root / self.pattern.format(**self.place, video_key=self.camera)
        path.parent.mkdir(parents=True, exist_ok=True)
        return path


@dataclass
class _Rows:
    """The rows of all episodes."""

    files: _Files
    _writer: pq.ParquetWriter | None = None

    def append(self, path: Path, numbers: dict[str, NDArray[np.int64]]) -> dict[str, Any]:
        """Appends a part's rows with other numbers, (T,) each, and returns where they are."""
        if self.files.take(path):
            self.close()
        table = pq.ParquetFile(path).read()
        for name, values in numbers.items():
            column = table.schema.get_field_index(name)
            table = table.set_column(column, table.schema.field(column), pa.array(values))
        if self._writer is None:
            self._writer = pq.ParquetWriter(self.files.path(), table.schema)
        self._writer.write_table(table)
        return {f"data/{name}": value for name, value in self.files.place.items()}

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None


@dataclass
class _Videos:
    """The videos of one camera."""

    files: _Files
    _waiting: list[Path] = field(default_factory=list)
    _target: Path | None = None
    _seconds: float = 0.0

    def append(self, path: Path, seconds: float) -> dict[str, Any]:
        """Appends a part's video of a length (s), which must stay until the file is full; returns where it will be."""
        if self.files.take(path):
            self.close()
        self._target = self.files.path()
        self._waiting.append(path)
        start, self._seconds = self._seconds, self._seconds + seconds
        where = {**self.files.place, "from_timestamp": start, "to_timestamp": self._seconds}
        return {f"videos/{self.files.camera}/{name}": value for name, value in where.items()}

    def close(self) -> None:
        from lerobot.datasets.video_utils import concatenate_video_files  # not exported by lerobot.datasets

        if self._target is None:
            return
        if len(self._waiting) == 1:
            shutil.copyfile(self._waiting[0], self._target)
        else:
            concatenate_video_files(self._waiting, self._target)
        self._waiting, self._target, self._seconds = [], None, 0.0
