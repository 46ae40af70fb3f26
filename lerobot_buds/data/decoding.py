"""Decodes the frames of episodes by LeRobot's own decoders, so that they are to the bit what LeRobotDataset returns."""

import threading
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from datasets import Image
from lerobot.datasets.video_utils import (  # not exported by lerobot.datasets
    VideoDecoderCache,
    decode_video_frames_pyav,
    decode_video_frames_torchcodec,
)
from lerobot.utils.import_utils import get_safe_default_video_backend
from numpy.typing import NDArray

from lerobot_buds.core import ConfigError, DatasetError, near_names

from .cameras import frame_size
from .dataset import LocalDataset

Pixels = NDArray[np.uint8]
Rows = Iterator[tuple[int, Pixels]]
"""Absolute index of a first frame, and ``(n, 3, H, W)`` frames from there on."""

BACKENDS = ("torchcodec", "pyav")
CHUNK = 64
"""Frames decoded at once: 59 MB at 640 x 480."""

_decoders = threading.local()


@dataclass(frozen=True)
class Portion:
    """Episodes that are decoded together, by one thread.

    Attributes:
        records: Their records.
        read: Decodes them.
    """

    records: Sequence[Mapping[str, Any]]
    read: Callable[[], Rows]

    @property
    def episodes(self) -> list[int]:
        """Their numbers."""
        return [int(record["episode_index"]) for record in self.records]


def backend_of(dataset: LocalDataset) -> str:
    """Tells which decoder LeRobot uses for the videos of a dataset.

    Raises:
        ConfigError: An unknown one was asked for.
    """
    backend = dataset.video_backend or _default_backend()
    backend = "pyav" if backend == "video_reader" else backend  # LeRobot's alias
    if backend not in BACKENDS:
        raise ConfigError(f"video_backend={backend!r} is unknown. {near_names(backend, BACKENDS)}")
    return backend


@cache
def _default_backend() -> str:
    """Asks LeRobot once: where torchcodec cannot be loaded, it says so at every question."""
    return str(get_safe_default_video_backend())


def portions(dataset: LocalDataset, camera: str, records: Sequence[Mapping[str, Any]]) -> list[Portion]:
    """Divides the decoding of episodes: one by one from videos, file by file from images.

    Args:
        dataset: The dataset.
        camera: Name of an RGB camera.
        records: Records of episodes whose files are on this machine.
    """
    if dataset.features[camera]["dtype"] == "video":
        return [Portion([record], partial(_of_video, dataset, camera, record)) for record in records]
    by_path: dict[Path, list[Mapping[str, Any]]] = {}
    for record in records:
        by_path.setdefault(dataset.frames_path(record, camera), []).append(record)
    return [Portion(inside, partial(_of_images, dataset, camera, path, inside)) for path, inside in by_path.items()]


def _of_video(dataset: LocalDataset, camera: str, record: Mapping[str, Any]) -> Rows:
    path, first = dataset.video_path(record, camera), int(record["dataset_from_index"])
    start, length, fps = dataset.video_start(record, camera), int(record["length"]), dataset.fps
    backend, size = backend_of(dataset), frame_size(dataset.features[camera], camera)
    for begin in range(0, length, CHUNK):
        times = [start + frame / fps for frame in range(begin, min(begin + CHUNK, length))]
        try:
            # Half a frame, so that the right frame is found wherever LeRobot's narrower bound lets it be found, and in
            # files so long that float32 holds their times no more exactly than that bound.
            frames = _decode(path, times, 0.5 / fps, backend)
        except (ValueError, IndexError, RuntimeError, OSError) as error:
            raise _damage(dataset, camera, record, error) from error
        if frames.shape[1:] != (3, *size):
            raise DatasetError(f"{path} holds frames of shape {frames.shape[1:]}; info.json says {(3, *size)}.")
        yield first + begin, frames


def _decode(path: Path, times: list[float], tolerance_s: float, backend: str) -> Pixels:
    if backend == "pyav":
        frames = decode_video_frames_pyav(path, times, tolerance_s, return_uint8=True)
    else:
        # LeRobot shares its decoders between threads, which torchcodec does not allow.
        if not hasattr(_decoders, "cache"):
            _decoders.cache = VideoDecoderCache(max_size=2)
        frames = decode_video_frames_torchcodec(
            path, times, tolerance_s, decoder_cache=_decoders.cache, return_uint8=True
        )
    pixels: Pixels = frames.numpy()
    return pixels


def _damage(dataset: LocalDataset, camera: str, record: Mapping[str, Any], error: Exception) -> DatasetError:
    path = dataset.video_path(record, camera)
    neighbours = [r for r in dataset.all_episodes if dataset.video_path(r, camera) == path]
    starts = [dataset.video_start(r, camera) for r in neighbours]
    count, damage = _frames_inside(
        path, starts, [r["episode_index"] for r in neighbours].index(record["episode_index"]), dataset.fps
    )
    return DatasetError(
        f"{path}: episode {record['episode_index']} has {record['length']} rows but only {count} video frames of "
        f"{camera!r}{damage or f' that its decoder finds in time ({error})'}; the file was probably cut off: fetch it "
        "again, or remove the episode with lerobot-edit-dataset."
    )


def _frames_inside(path: Path, starts: list[float], number: int, fps: float) -> tuple[int, str]:
    """Counts the readable frames of one of the episodes of a file, by their times; says what stopped the reading."""
    order = sorted(range(len(starts)), key=starts.__getitem__)
    sorted_starts, place, count = [starts[k] for k in order], order.index(number), 0
    try:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            for frame in container.decode(stream):
                time = float(frame.pts * stream.time_base)
                count += max(0, bisect_right(sorted_starts, time + 0.5 / fps) - 1) == place
    except (av.FFmpegError, IndexError) as error:
        return count, f" ({error})"
    return count, ""


def _of_images(dataset: LocalDataset, camera: str, path: Path, records: Sequence[Mapping[str, Any]]) -> Rows:
    wanted = np.zeros(dataset.total_frames, dtype=np.bool_)
    for record in records:
        wanted[int(record["dataset_from_index"]) : int(record["dataset_to_index"])] = True
    run: list[Pixels] = []
    first = -1
    for index, cell in image_cells(path, dataset.stored_name(camera)):
        if run and (index != first + len(run) or len(run) == CHUNK):
            yield first, np.stack(run)
            run = []
        if wanted[index]:
            first = first if run else index
            run.append(_decoded_cell(dataset, camera, index, cell).transpose(2, 0, 1))
    if run:
        yield first, np.stack(run)


def image_cells(path: Path, column: str) -> Iterator[tuple[int, Any]]:
    """Reads the stored cells of a camera with the absolute indices of their frames, a few at a time.

    Args:
        path: A parquet file of a dataset.
        column: Name of an image feature in it.

    Raises:
        DatasetError: The file cannot be read.
    """
    try:
        with pq.ParquetFile(path) as file:
            for batch in file.iter_batches(CHUNK, columns=["index", column]):
                yield from zip(batch["index"].to_pylist(), batch[column].to_pylist(), strict=True)
    except (pa.ArrowException, OSError) as error:
        raise DatasetError(f"{path} cannot be read ({error}); fetch it again.") from error


def _decoded_cell(dataset: LocalDataset, camera: str, index: int, cell: Any) -> Pixels:
    where = f"{dataset.root}: the image of {camera!r} at index {index}"
    if cell is None or (cell["bytes"] is None and cell["path"] is None):
        raise DatasetError(f"{where} is empty. Store it, or remove its episode with lerobot-edit-dataset.")
    try:
        image: Pixels = np.asarray(Image().decode_example(cell))
    except FileNotFoundError as error:
        raise DatasetError(f"{where} lies in {cell['path']}, which is not there; bring the file back.") from error
    except (OSError, ValueError) as error:
        raise DatasetError(f"{where} is damaged ({error}); store it again, or remove its episode.") from error
    size = frame_size(dataset.features[camera], camera)
    if image.shape != (*size, 3):
        raise DatasetError(
            f"{where} has shape {image.shape}; info.json says {(*size, 3)}, and LeRobot hands over what is stored. "
            "Store RGB images of one size."
        )
    return image
