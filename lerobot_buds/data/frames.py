"""Frames at the size that is used: decoded once, scaled once, kept in the frame store, read at random ever after.

An array is named by the content that it was decoded from, its decoder and its size. So a segmented copy of a dataset,
whose videos are byte-identical copies, shares the frames of its source, and so do a subset and the whole.
"""

import logging
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from lerobot_buds.core import DatasetError, StorageError, sha256_of_file, sha256_of_json

from .cameras import frame_size
from .dataset import AnyDataset, LocalDataset
from .decoding import Portion, backend_of, image_cells, portions
from .scaling import scale_images
from .store import EpisodeArray, FrameStore
from .writing import only_writer

logger = logging.getLogger(__name__)

Frames = NDArray[np.uint8]

ATTEMPTS = 5
"""How often frames are decoded that vanish at once: the store may be removed at any time, by others too."""


def cached_frames(
    dataset: AnyDataset, camera: str, cache_dir: Path | None = None, size: tuple[int, int] | None = None
) -> Frames:
    """Opens the frames of one camera, decoding first what the frame store does not hold yet of the chosen episodes.

    Safe to call from several processes at once: one decodes, the others wait.

    Args:
        dataset: What stands for the dataset.
        camera: Name of an RGB camera, for example ``"observation.images.agentview"``.
        cache_dir: Folder of the frame store; default ``$HF_LEROBOT_HOME/buds_cache``.
        size: Height and width (pixels) to which frames are scaled by `scale_images`; as they are stored where None.

    Returns:
        Read-only memory map ``(N, 3, h, w)`` uint8, indexed by the absolute frame ``index`` of the whole dataset.
        Frames that were not chosen, or that a partial download lacks, are black.

    Raises:
        DatasetError: The camera is missing, or its frames are damaged or fewer than the rows.
        StorageError: They do not fit into the store or onto the disk, or cannot be written.
    """
    local = LocalDataset.of(dataset)
    local.require([camera])
    stored = frame_size(local.features[camera], camera)
    size = size or stored
    store = FrameStore.open(cache_dir)
    path = store.folder / f"{frames_key(local, camera, size)[:32]}.npy"
    what = f"{camera}, {size[0]} x {size[1]}: {local.root}"
    array = EpisodeArray(path, (local.total_frames, 3, *size), np.uint8, what)
    here = _local_episodes(local, camera)
    for _ in range(ATTEMPTS):
        try:
            if _missing(array, here):
                with only_writer(path, wait=True):
                    _fill(store, array, local, camera, _missing(array, here))
            frames: Frames = array.read()
        except FileNotFoundError:
            logger.warning("%s was removed from the frame store meanwhile, and is made again", path)
            continue
        if not _missing(array, here):
            return frames
    raise StorageError(
        f"{path} was removed {ATTEMPTS} times while it was made: others need its room in the frame store. Raise "
        "BUDS_STORE_LIMIT (for example 200GB), or run one after the other."
    )


def frames_key(dataset: AnyDataset, camera: str, size: tuple[int, int] | None = None) -> str:
    """Hashes everything that determines a camera's frames: stored bytes, decoder, size and the lengths of episodes.

    Args:
        dataset: What stands for the dataset; which episodes were chosen does not matter.
        camera: Name of an RGB camera.
        size: Height and width (pixels) of the frames; as they are stored where None.

    Returns:
        A hexadecimal SHA-256.
    """
    local = LocalDataset.of(dataset)
    local.require([camera])
    is_video = local.features[camera]["dtype"] == "video"
    path_of = [local.frames_path(record, camera) for record in local.all_episodes]
    paths = list(dict.fromkeys(path_of))
    place_of = {path: place for place, path in enumerate(paths)}
    if is_video:
        content = [_video_hash(path, _stamp(path)) if path.exists() else None for path in paths]
        starts = [local.video_start(record, camera) for record in local.all_episodes]
    else:
        column = local.stored_name(camera)
        content = [_images_hash(path, column, _stamp(path)) if path.exists() else None for path in paths]
        starts = []
    return sha256_of_json(
        {
            "version": 2,
            "size": size or frame_size(local.features[camera], camera),
            "lengths": [int(record["length"]) for record in local.all_episodes],
            "content": content,
            "places": [place_of[path] for path in path_of],
            "starts": starts,
            "decoder": backend_of(local) if is_video else "images",
        }
    )


def _stamp(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=4096)
def _video_hash(path: Path, stamp: tuple[int, int]) -> str:
    return sha256_of_file(path)


@lru_cache(maxsize=4096)
def _images_hash(path: Path, column: str, stamp: tuple[int, int]) -> str:
    digest = sha256()
    for index, cell in image_cells(path, column):
        content = (cell or {}).get("bytes")
        source = (cell or {}).get("path") if content is None else None
        if source is not None and Path(source).is_file():
            content = Path(source).read_bytes()
        digest.update(f"{index}:{-1 if content is None else len(content)}:".encode() + (content or b""))
    return digest.hexdigest()


def _local_episodes(dataset: LocalDataset, camera: str) -> list[Mapping[str, Any]]:
    """Lists the chosen episodes whose frames are on this machine; names the others in a warning."""
    here: list[Mapping[str, Any]] = []
    absent: list[int] = []
    for record in dataset.episodes:
        if dataset.frames_path(record, camera).exists():
            here.append(record)
        else:
            absent.append(int(record["episode_index"]))
    if absent and not here:
        raise DatasetError(f"{dataset.root} holds no frames of {camera!r}: download the files of the dataset first.")
    if absent:
        logger.warning("%s lacks the frames of %s of episodes %s: they stay black", dataset.root, camera, absent)
    return here


def _missing(array: EpisodeArray, records: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    finished = array.finished()
    return [record for record in records if int(record["episode_index"]) not in finished]


def _fill(
    store: FrameStore, array: EpisodeArray, dataset: LocalDataset, camera: str, records: Sequence[Mapping[str, Any]]
) -> None:
    """Decodes episodes into an array in threads: decoders, scaling and files all let go of Python's lock."""
    frames = sum(int(record["length"]) for record in records)
    if not frames:
        return
    store.reserve(array.path, frames * array.row_bytes)
    try:
        array.create()
        with (
            tqdm(total=frames, desc=f"decoding {camera}", unit="frame", leave=False) as bar,
            ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool,
        ):
            work = {pool.submit(_decode, array, part, bar): part for part in portions(dataset, camera, records)}
            try:
                for done in as_completed(work):
                    done.result()
                    array.finish(work[done].episodes)
            except BaseException:
                pool.shutdown(wait=True, cancel_futures=True)
                whole = [part for done, part in work.items() if not done.cancelled() and done.exception() is None]
                array.finish(number for part in whole for number in part.episodes)
                raise
    except FileNotFoundError:
        raise
    except OSError as error:
        array.remove()
        raise StorageError(
            f"{array.path} could not be written ({error}); it needs {frames * array.row_bytes:,} bytes. Make room on "
            "its disk, or set HF_LEROBOT_HOME to another one."
        ) from error


def _decode(array: EpisodeArray, portion: Portion, bar: "tqdm[Any]") -> None:
    size = array.shape[2], array.shape[3]
    for start, pixels in portion.read():
        array.write(start, scale_images(torch.from_numpy(np.ascontiguousarray(pixels)), size).numpy())
        bar.update(len(pixels))
