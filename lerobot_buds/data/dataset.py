"""A LeRobotDataset on this machine: where it lies, what of it was chosen, and what its metadata says.

Reads lazily and changes nothing. Needs neither torch nor LeRobot, unless a LeRobotDataset is handed over.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_buds.core import DatasetError, near_names, read_json

from .cameras import rgb_cameras

if TYPE_CHECKING:
    from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata

FPS_RANGE = (0.1, 1000.0)
"""Control rates outside are a mistake of the recorder (frames per second)."""

_INFO_KEYS = ("fps", "features", "total_frames", "data_path")

type AnyDataset = LocalDataset | LeRobotDataset | LeRobotDatasetMetadata | Path | str
"""What stands for a dataset: ours, LeRobot's, or its folder. `LocalDataset.of` makes one of any."""


@dataclass(frozen=True, eq=False)
class LocalDataset:
    """A LeRobotDataset of format v3, with the choices of whoever uses it; these reach everything that reads it.

    Attributes:
        root: Its folder.
        chosen: Numbers of the episodes to use; all where None.
        renamed: Name of a feature in the files -> name to use for it, as LeRobot's ``rename_map``.
        video_backend: LeRobot's decoder of videos; its default where None.
        revision: Branch, tag or commit that was asked for on the Hub; recorded, not read.
        repo_id: Its name, where that is known; recorded, not read.
    """

    root: Path
    chosen: tuple[int, ...] | None = None
    renamed: Mapping[str, str] = field(default_factory=dict)
    video_backend: str | None = None
    revision: str | None = None
    repo_id: str | None = None

    def __post_init__(self) -> None:
        # Resolved once: a relative `run-10:30` looks like a URL to some libraries.
        object.__setattr__(self, "root", Path(self.root).absolute())
        if self.chosen is not None:
            object.__setattr__(self, "chosen", tuple(sorted({int(number) for number in self.chosen})))

    @classmethod
    def of(cls, dataset: AnyDataset) -> "LocalDataset":
        """Makes one of whatever stands for a dataset: a folder, or LeRobot's own object with all that was chosen there.

        Args:
            dataset: A `LocalDataset`, a folder, a LeRobotDataset or its metadata.
        """
        if isinstance(dataset, LocalDataset):
            return dataset
        if isinstance(dataset, str | Path):
            return cls(Path(dataset))
        episodes = getattr(dataset, "episodes", None)
        # The metadata's attribute of this name holds records, not a choice.
        chosen = tuple(episodes) if isinstance(episodes, list) else None
        backend = getattr(dataset, "_video_backend", None)  # LeRobot has no public name for it
        return cls(Path(dataset.root), chosen, {}, backend, dataset.revision, dataset.repo_id)

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

    @cached_property
    def features(self) -> dict[str, dict[str, Any]]:
        """The features by the names to use, each with ``dtype``, ``shape`` and ``names``.

        Raises:
            DatasetError: A feature that is to be renamed does not exist, or two would have one name.
        """
        stored: dict[str, dict[str, Any]] = self.info["features"]
        for name in self.renamed:
            if name not in stored:
                raise DatasetError(f"{self.root} has no {name!r} to rename. {near_names(name, stored)}")
        names = [self.renamed.get(name, name) for name in stored]
        if len(set(names)) < len(names):
            raise DatasetError(f"{self.root}: renaming by {dict(self.renamed)} gives two features one name.")
        return dict(zip(names, stored.values(), strict=True))

    def stored_name(self, name: str) -> str:
        """Name of a feature in the files."""
        return {new: old for old, new in self.renamed.items()}.get(name, name)

    @property
    def cameras(self) -> list[str]:
        """The RGB cameras, told by LeRobot's feature type, in the order of their names."""
        return rgb_cameras(self.features)

    @property
    def fps(self) -> float:
        """Frame rate (frames per second), exactly as it is stored.

        Raises:
            DatasetError: It is outside `FPS_RANGE`.
        """
        fps = float(self.info["fps"])
        if not FPS_RANGE[0] <= fps <= FPS_RANGE[1]:
            raise DatasetError(f"{self.root}/meta/info.json: fps={fps:g} is outside {FPS_RANGE}; correct it.")
        return fps

    @property
    def total_frames(self) -> int:
        """Number of frames of the whole dataset, chosen and downloaded or not."""
        return int(self.info["total_frames"])

    @cached_property
    def all_episodes(self) -> list[dict[str, Any]]:
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

    @cached_property
    def episodes(self) -> list[dict[str, Any]]:
        """The records of the chosen episodes.

        Raises:
            DatasetError: An episode was chosen that does not exist, or none was.
        """
        if self.chosen is None:
            return self.all_episodes
        count = len(self.all_episodes)
        outside = [number for number in self.chosen if not 0 <= number < count]
        if outside or not self.chosen:
            raise DatasetError(f"{self.root} has episodes 0 to {count - 1}; chosen were {outside or 'none'}.")
        return [self.all_episodes[number] for number in self.chosen]

    def data_path(self, record: Mapping[str, Any]) -> Path:
        """Path of the parquet file that holds an episode's rows."""
        pattern: str = self.info["data_path"]
        return self.root / pattern.format(chunk_index=record["data/chunk_index"], file_index=record["data/file_index"])

    def video_path(self, record: Mapping[str, Any], camera: str) -> Path:
        """Path of the video file that holds an episode's frames of one camera."""
        pattern: str = self.info["video_path"]
        stored = self.stored_name(camera)
        return self.root / pattern.format(
            video_key=stored,
            chunk_index=record[f"videos/{stored}/chunk_index"],
            file_index=record[f"videos/{stored}/file_index"],
        )

    def frames_path(self, record: Mapping[str, Any], camera: str) -> Path:
        """Path of the file that holds an episode's frames of one camera, be they a video or images among its rows."""
        is_video = self.features[camera]["dtype"] == "video"
        return self.video_path(record, camera) if is_video else self.data_path(record)

    def video_start(self, record: Mapping[str, Any], camera: str) -> float:
        """Time at which an episode begins in its video file of one camera (seconds)."""
        return float(record[f"videos/{self.stored_name(camera)}/from_timestamp"])

    def require(self, names: Sequence[str], remedy: str = "name others in the settings, or record them") -> None:
        """Refuses a dataset that lacks any of the named features, naming all missing ones at once.

        Args:
            names: The features.
            remedy: What to do about it, for the message.

        Raises:
            DatasetError: At least one feature is missing.
        """
        missing = [name for name in names if name not in self.features]
        if missing:
            lines = "\n".join(f"  {name!r}: {near_names(name, self.features)}" for name in missing)
            raise DatasetError(f"{self.root} lacks {len(missing)} required feature(s); {remedy}:\n{lines}")

    def shards(self, columns: Sequence[str]) -> Iterator[pa.Table]:
        """Reads the local parquet files that hold chosen episodes one after the other.

        Args:
            columns: Names of the columns to read.

        Yields:
            Tables with the column ``index`` and those asked for, by the names to use; rows of other episodes may be
            among theirs.

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
                table = pq.read_table(path, columns=[self.stored_name(name) for name in names])
            except (pa.ArrowException, OSError) as error:
                inside = [int(r["episode_index"]) for r in self.all_episodes if self.data_path(r) == path]
                raise DatasetError(
                    f"{path} cannot be read ({error}). It holds episodes {inside[0]} to {inside[-1]}; it was probably "
                    "cut off while copying: fetch it again, or remove these episodes with lerobot-edit-dataset."
                ) from error
            yield table.rename_columns([self.renamed.get(name, name) for name in table.column_names])
