"""Decodes a camera's frames once, sequentially, into a memory map that every later stage reads at random.

The map is named by the content it was decoded from, so a segmented copy of a dataset, whose videos are byte-identical
copies, shares the map of its source. Frames are bit-identical to those that LeRobotDataset returns.
"""

import logging
import os
import shutil
from bisect import bisect_right
from collections.abc import Iterator
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import av
import numpy as np
from lerobot.utils.constants import HF_LEROBOT_HOME
from numpy.typing import NDArray
from PIL import Image
from tqdm import tqdm

from lerobot_buds.core import DatasetError, sha256_of_file, sha256_of_json

from .tables import DatasetFiles
from .writing import make_once

logger = logging.getLogger(__name__)

Frames = NDArray[np.uint8]


def cached_frames(root: Path, camera: str, cache_dir: Path | None = None) -> Frames:
    """Opens all frames of one camera, decoding them first where the cache does not hold them yet.

    Safe to call from several processes at once: one decodes, the others wait.

    Args:
        root: Folder of a LeRobotDataset, format v3.
        camera: Name of an image or video feature, for example ``"observation.images.agentview"``.
        cache_dir: Folder of the cache; default ``$HF_LEROBOT_HOME/buds_cache``.

    Returns:
        Read-only memory map ``(N, 3, H, W)`` uint8, indexed by the absolute frame ``index``. Frames that a partial
        download lacks are black.

    Raises:
        DatasetError: The camera is missing, a video is damaged or holds fewer frames than its episodes have rows, or
            the disk is too small.
        StorageError: The cache cannot be written.
    """
    files = DatasetFiles(root)
    files.require([camera])
    shape = (files.total_frames, 3, *frame_size(files.features[camera], camera))
    folder = cache_dir or HF_LEROBOT_HOME / "buds_cache"
    path = folder / f"{frames_key(root, camera)[:32]}.npy"
    make_once(path, lambda part: _decode(files, camera, shape, part))
    frames: Frames = np.load(path, mmap_mode="r")
    return frames


def frames_key(root: Path, camera: str) -> str:
    """Hashes everything that determines a camera's frames: the stored bytes, their size and the episode lengths.

    Args:
        root: Folder of a LeRobotDataset, format v3.
        camera: Name of an image or video feature.

    Returns:
        A hexadecimal SHA-256.
    """
    files = DatasetFiles(root)
    files.require([camera])
    is_video = files.features[camera]["dtype"] == "video"
    content: list[str | None]
    if is_video:
        paths = list(dict.fromkeys(files.video_path(record, camera) for record in files.episodes))
        content = [sha256_of_file(path) if path.exists() else None for path in paths]
        places: list[Any] = [
            [paths.index(files.video_path(record, camera)), record[f"videos/{camera}/from_timestamp"]]
            for record in files.episodes
        ]
    else:
        digest = sha256()
        for index, image in _stored_images(files, camera):
            digest.update(f"{index}:{len(image)}:".encode() + image)
        content, places = [digest.hexdigest()], []
    lengths = [int(record["length"]) for record in files.episodes]
    size = frame_size(files.features[camera], camera)
    return sha256_of_json(
        {"version": 1, "camera": camera, "size": size, "lengths": lengths, "content": content, "places": places}
    )


def frame_size(feature: dict[str, Any], camera: str) -> tuple[int, int]:
    """Reads height and width (pixels) from an image feature, whichever place its channels have.

    Args:
        feature: Feature record of ``meta/info.json``.
        camera: Its name, for the message.

    Raises:
        DatasetError: The feature holds no RGB images.
    """
    shape, names = tuple(feature["shape"]), feature.get("names") or []
    if feature["dtype"] in ("video", "image") and len(shape) == 3:
        channels_first = len(names) == 3 and str(names[0]).startswith("channel")
        channels, height, width = shape if channels_first else (shape[2], shape[0], shape[1])
        if channels == 3:
            return int(height), int(width)
    raise DatasetError(
        f"{camera!r} of type {feature['dtype']}, shape {shape} and names {names} is no RGB camera. Leave it out of the "
        "cameras, or correct meta/info.json."
    )


def _require_space(folder: Path, needed: int, camera: str) -> None:
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise DatasetError(
            f"decoding {camera!r} needs {needed:,} bytes in {folder}, but only {free:,} are free; "
            "make room, or set HF_LEROBOT_HOME to a larger disk."
        )


def _decode(files: DatasetFiles, camera: str, shape: tuple[int, ...], part: Path) -> None:
    _require_space(part.parent, int(np.prod(shape)), camera)
    frames: np.memmap[Any, np.dtype[np.uint8]] = np.lib.format.open_memmap(  # type: ignore[no-untyped-call]
        part, "w+", np.uint8, shape
    )
    with part.open("r+b") as file:
        # A full disk must show here as an error; at a page of the map it would kill the process.
        os.posix_fallocate(file.fileno(), 0, part.stat().st_size)
    is_video = files.features[camera]["dtype"] == "video"
    source = _video_frames(files, camera) if is_video else _image_frames(files, camera)
    for index, image in tqdm(source, total=shape[0], desc=f"decoding {camera}", unit="frame", leave=False):
        if image.shape != (*shape[2:], 3):
            raise DatasetError(
                f"{files.root}: {camera!r} holds a frame of {image.shape} at index {index}; "
                f"info.json says {(*shape[2:], 3)}."
            )
        frames[index] = image.transpose(2, 0, 1)
    frames.flush()


def _stored_images(files: DatasetFiles, camera: str) -> Iterator[tuple[int, bytes]]:
    for shard in files.shards([camera]):
        for index, cell in zip(shard["index"].to_pylist(), shard[camera], strict=True):
            yield index, cell["bytes"].as_py()


def _image_frames(files: DatasetFiles, camera: str) -> Iterator[tuple[int, Frames]]:
    for index, image in _stored_images(files, camera):
        try:
            yield index, np.asarray(Image.open(BytesIO(image)).convert("RGB"))
        except OSError as error:
            raise DatasetError(
                f"{files.root}: the image of {camera!r} at index {index} is damaged ({error})."
            ) from error


def _video_frames(files: DatasetFiles, camera: str) -> Iterator[tuple[int, Frames]]:
    by_path: dict[Path, list[dict[str, Any]]] = {}
    for record in files.episodes:
        by_path.setdefault(files.video_path(record, camera), []).append(record)
    absent = [path for path in by_path if not path.exists()]
    if len(absent) == len(by_path):
        raise DatasetError(f"{files.root} holds no video of {camera!r}: download the videos of the dataset first.")
    for path in absent:
        numbers = [record["episode_index"] for record in by_path[path]]
        logger.warning("%s is not there: episodes %d to %d of %s stay black", path, numbers[0], numbers[-1], camera)
    for path, records in by_path.items():
        if path not in absent:
            yield from _frames_of_file(path, records, camera, files.fps)


def _frames_of_file(path: Path, records: list[dict[str, Any]], camera: str, fps: float) -> Iterator[tuple[int, Frames]]:
    """Places every decoded frame by its time, the way LeRobot finds it, and counts the frames of each episode."""
    records = sorted(records, key=lambda record: float(record[f"videos/{camera}/from_timestamp"]))
    begins = [float(record[f"videos/{camera}/from_timestamp"]) for record in records]
    counts = [0] * len(records)
    damage = ""
    try:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            # Frame threads give the same pixels in the same order, sooner.
            stream.thread_type = "AUTO"
            for frame in container.decode(stream):
                time = float(frame.pts * stream.time_base)
                k = max(0, bisect_right(begins, time + 0.5 / fps) - 1)
                number = round((time - begins[k]) * fps)
                if number == counts[k] and number < int(records[k]["length"]):
                    counts[k] += 1
                    yield int(records[k]["dataset_from_index"]) + number, frame.to_ndarray(format="rgb24")
    except (av.FFmpegError, IndexError) as error:
        damage = f" ({error})"
    for record, count in zip(records, counts, strict=True):
        if count < int(record["length"]):
            raise DatasetError(
                f"{path}: episode {record['episode_index']} has {record['length']} rows but only {count} video frames"
                f"{damage}; the file was probably cut off: fetch it again, or remove the episode with "
                "lerobot-edit-dataset."
            )
