"""Writes episodes through LeRobot's own writer, with the settings that keep every frame and a quiet terminal."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock, Timeout
from numpy.typing import NDArray

from lerobot_buds.core import (
    ConfigError,
    DatasetError,
    StorageError,
    read_json,
    remove_leftovers,
    write_atomically,
    write_json,
)

if TYPE_CHECKING:
    from lerobot.datasets import LeRobotDataset

_LONGEST = 100_000

SMALLEST_VIDEO = 32
"""Pixels a side of the smallest video; LeRobot's encoder, SVT-AV1, crashes the process on images of under 28."""


def camera_feature(shape: tuple[int, ...], video: bool) -> dict[str, Any]:
    """Describes a camera of ``(H, W, 3)`` uint8 frames for LeRobot, stored as video or as images."""
    return {"dtype": "video" if video else "image", "shape": shape, "names": ["height", "width", "channels"]}


def vector_feature(names: Sequence[str]) -> dict[str, Any]:
    """Describes a float32 vector with one name per dimension for LeRobot."""
    return {"dtype": "float32", "shape": (len(names),), "names": list(names)}


@contextmanager
def only_writer(target: Path, wait: bool = False) -> Iterator[None]:
    """Keeps other processes from writing the same folder or file; a killed one keeps nobody away.

    Args:
        target: What is written; the lock lies beside it.
        wait: Waits for another process to end instead of refusing.

    Raises:
        DatasetError: Another process is writing it.
        StorageError: There is no writing where it lies.
    """
    lock = FileLock(target.with_name(f".{target.name}.lock"), timeout=-1 if wait else 0)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        raise DatasetError(f"Another process is writing {target}; wait for it, or end it.") from None
    except OSError as error:
        raise StorageError(f"{target} cannot be written ({error}); choose a folder that can be.") from error
    try:
        yield
    finally:
        lock.release()


def make_once(path: Path, write: Callable[[Path], None]) -> None:
    """Writes a file of a cache unless it is there; of several processes that ask for it one writes, the others wait.

    Args:
        path: The file.
        write: Called with the temporary path that it must fill.

    Raises:
        StorageError: It cannot be written.
    """
    with only_writer(path, wait=True):
        if not path.exists():
            remove_leftovers(path.parent, path.name)
            write_atomically(path, write)


def require_encodable(features: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuses cameras that LeRobot's video encoder cannot encode: SVT-AV1 ends the whole process on tiny images.

    Every dataset passes here when it is created; call it earlier where much is done before that.

    Args:
        features: LeRobot's features, images as ``(H, W, 3)``.

    Raises:
        ConfigError: A video is too small; names its camera and size.
    """
    for name, feature in features.items():
        height, width = feature["shape"][:2] if feature["dtype"] == "video" else (SMALLEST_VIDEO, SMALLEST_VIDEO)
        if min(height, width) < SMALLEST_VIDEO:
            raise ConfigError(
                f"{name!r} is {width} x {height} pixels, but video has at least {SMALLEST_VIDEO} a side: choose larger "
                "images, or store images instead of video with --video=false."
            )


def create_dataset(
    repo_id: str,
    root: Path,
    fps: float,
    features: Mapping[str, Mapping[str, Any]],
    robot_type: str | None = None,
    encoder_threads: int | None = None,
) -> "LeRobotDataset":
    """Creates an empty dataset to write to; its user finalizes it.

    Args:
        repo_id: The dataset's name.
        root: Its folder, which must not exist.
        fps: Frame rate (frames per second), kept as it is: a whole number best as an int, as LeRobot's own are.
        features: LeRobot's features.
        robot_type: The robot's name, where it is known.
        encoder_threads: Threads that encode each video; the encoder's choice where None.

    Raises:
        ConfigError: A camera's images are too small for video.
    """
    require_encodable(features)
    os.environ.setdefault("SVT_LOG", "1")  # errors only; the encoder describes itself at length otherwise
    import av.logging
    from datasets import disable_progress_bars
    from lerobot.datasets import LeRobotDataset

    av.logging.set_libav_level(av.logging.ERROR)  # LeRobot resets the level that set_level sets
    disable_progress_bars()
    video = any(feature["dtype"] == "video" for feature in features.values())
    dataset = LeRobotDataset.create(
        repo_id=repo_id,
        root=root,
        fps=fps,
        robot_type=robot_type,
        features=dict(features),
        use_videos=video,
        streaming_encoding=video,
        encoder_queue_maxsize=_LONGEST,  # a full queue would silently drop frames: longer than any episode
        image_writer_threads=0 if video else 4,
        encoder_threads=encoder_threads,
    )
    encoder = getattr(dataset.writer, "_streaming_encoder", None)
    if encoder is not None and fps != int(fps):
        # LeRobot hands its rate to FFmpeg as it is, which takes whole numbers and fractions: 29.97 is 2997/100.
        encoder.fps = Fraction(fps).limit_denominator(100_000)
    return dataset


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

    Raises:
        StorageError: A video cannot be written.
    """
    length = len(next(iter(columns.values())))
    for t in range(length):
        dataset.add_frame({name: column[t] for name, column in columns.items()} | {"task": task})
    try:
        dataset.save_episode()
    except RuntimeError as error:  # what became of a thread of LeRobot's encoder
        raise StorageError(
            f"{dataset.root} could not be written ({error}). Make room on its disk, or see to its permissions, and run "
            "the same command again."
        ) from error
    return length
