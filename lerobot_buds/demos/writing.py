"""Writes episodes through LeRobot's own writer, with the settings that keep every frame and a quiet terminal."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from lerobot_buds.core import read_json, write_json

if TYPE_CHECKING:
    from lerobot.datasets import LeRobotDataset

_LONGEST = 100_000


def camera_feature(shape: tuple[int, ...], video: bool) -> dict[str, Any]:
    """Describes a camera of ``(H, W, 3)`` uint8 frames for LeRobot, stored as video or as images."""
    return {"dtype": "video" if video else "image", "shape": shape, "names": ["height", "width", "channels"]}


def vector_feature(names: Sequence[str]) -> dict[str, Any]:
    """Describes a float32 vector with one name per dimension for LeRobot."""
    return {"dtype": "float32", "shape": (len(names),), "names": list(names)}


def create_dataset(
    repo_id: str, root: Path, fps: int, features: Mapping[str, Mapping[str, Any]], robot_type: str | None = None
) -> "LeRobotDataset":
    """Creates an empty dataset to write to; its user finalizes it.

    Args:
        repo_id: The dataset's name.
        root: Its folder, which must not exist.
        fps: Frame rate (frames per second).
        features: LeRobot's features.
        robot_type: The robot's name, where it is known.
    """
    os.environ.setdefault("SVT_LOG", "1")  # errors only; the encoder describes itself at length otherwise
    import av.logging
    from datasets import disable_progress_bars
    from lerobot.datasets import LeRobotDataset

    av.logging.set_libav_level(av.logging.ERROR)  # LeRobot resets the level that set_level sets
    disable_progress_bars()
    video = any(feature["dtype"] == "video" for feature in features.values())
    return LeRobotDataset.create(
        repo_id=repo_id,
        root=root,
        fps=fps,
        robot_type=robot_type,
        features=dict(features),
        use_videos=video,
        streaming_encoding=video,
        encoder_queue_maxsize=_LONGEST,  # a full queue would silently drop frames: longer than any episode
        image_writer_threads=0 if video else 4,
    )


def sort_stats(folder: Path) -> None:
    """Writes a finished dataset's statistics in a fixed order; LeRobot's is that of a set, another in every process."""
    path = folder / "meta" / "stats.json"
    write_json(path, read_json(path))


def write_episode(dataset: "LeRobotDataset", columns: Mapping[str, NDArray[Any]], task: str) -> int:
    """Appends one episode and returns its number of frames.

    Args:
        dataset: A dataset that is being written.
        columns: ``(T, ...)`` array of every feature.
        task: What the episode does, in words.
    """
    length = len(next(iter(columns.values())))
    for t in range(length):
        dataset.add_frame({name: column[t] for name, column in columns.items()} | {"task": task})
    dataset.save_episode()
    return length
