"""Writes an episode as a dataset of its own, a part, in whatever process has its frames.

Videos go through LeRobot's own writer. For images that takes three times as long as it must: each is stored in a
file, read back, and embedded row by row. Here they are encoded in memory, into a table of the same content.
"""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray
from PIL import Image

from lerobot_buds.core import staged_directory

from .writing import create_dataset, write_episode

if TYPE_CHECKING:
    from lerobot.datasets import LeRobotDatasetMetadata

_PNG_LEVEL = 1
"""LeRobot's for frames on their way into a video; its 6 for images takes three times as long and saves a tenth."""


def write_part(
    folder: Path,
    repo_id: str,
    fps: float,
    features: Mapping[str, Mapping[str, Any]],
    columns: Mapping[str, NDArray[Any]],
    task: str,
    robot_type: str | None = None,
    encoder_threads: int | None = None,
) -> None:
    """Writes a finished LeRobotDataset of one episode, which appears when it is whole.

    Args:
        folder: Its folder, which must not exist.
        repo_id: Name of the dataset to which it will belong.
        fps: Frame rate (frames per second).
        features: LeRobot's features; cameras are all videos or all images.
        columns: ``(T, ...)`` array of every feature, cameras as ``(T, H, W, 3)`` uint8.
        task: What the episode does, in words.
        robot_type: The robot's name, where it is known.
        encoder_threads: Threads that encode a video; the encoder's choice where None.

    Raises:
        ConfigError: A camera's images are too small for video.
        ValueError: A column is missing, or is of another type or shape than its feature.
    """
    with staged_directory(folder) as staging:
        if any(feature["dtype"] == "video" for feature in features.values()):
            dataset = create_dataset(repo_id, staging, fps, features, robot_type, encoder_threads)
            write_episode(dataset, columns, task)
            dataset.finalize()
        else:
            _write_images(staging, repo_id, fps, features, columns, task, robot_type)


def _write_images(
    root: Path,
    repo_id: str,
    fps: float,
    features: Mapping[str, Mapping[str, Any]],
    columns: Mapping[str, NDArray[Any]],
    task: str,
    robot_type: str | None,
) -> None:
    from datasets import Dataset
    from lerobot.datasets import LeRobotDatasetMetadata
    from lerobot.datasets.feature_utils import (  # not exported by lerobot.datasets
        get_hf_features_from_features,
        validate_frame,
    )

    meta = LeRobotDatasetMetadata.create(repo_id, fps, dict(features), robot_type, root, use_videos=False)
    validate_frame({name: column[0] for name, column in columns.items()} | {"task": task}, meta.features)
    meta.save_episode_tasks([task])
    rows = _rows(meta, columns)
    stored = {name: _pngs(rows[name]) if name in meta.image_keys else rows[name] for name in rows}
    # Through `datasets`, whose description of the columns in the file is what tells its readers which are images.
    table = Dataset.from_dict(stored, features=get_hf_features_from_features(meta.features)).with_format("arrow")[:]
    path = root / meta.data_path.format(chunk_index=0, file_index=0)
    path.parent.mkdir(parents=True)
    pq.write_table(table, path)
    where = {"data/chunk_index": 0, "data/file_index": 0, "dataset_from_index": 0, "dataset_to_index": len(table)}
    meta.save_episode(0, len(table), [task], _stats(meta, rows), where)
    meta.finalize()


def _rows(meta: "LeRobotDatasetMetadata", columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Adds LeRobot's own columns and orders all as the features are; vectors of one number become numbers."""
    length = len(next(iter(columns.values())))
    count, none = np.arange(length), np.zeros(length, dtype=np.int64)
    own = {
        "timestamp": count / meta.fps,  # s
        "frame_index": count,
        "episode_index": none,
        "index": count,
        "task_index": none,
    }
    rows = {name: {**columns, **own}[name] for name in meta.features}
    return {name: values[:, 0] if values.shape[1:] == (1,) else values for name, values in rows.items()}


def _pngs(images: NDArray[np.uint8]) -> list[dict[str, Any]]:
    """Encodes images, (T, H, W, 3), as `datasets` stores them, with the names that LeRobot gives them."""
    encoded = []
    for number, image in enumerate(images):
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, "PNG", compress_level=_PNG_LEVEL)
        encoded.append({"bytes": buffer.getvalue(), "path": f"frame-{number:06d}.png"})
    return encoded


def _stats(meta: "LeRobotDatasetMetadata", rows: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Computes LeRobot's statistics, of the frames that it would take for those of images."""
    from lerobot.datasets import DEFAULT_QUANTILES, get_feature_stats
    from lerobot.datasets.compute_stats import auto_downsample_height_width, sample_indices  # not exported

    stats = {}
    for name, values in rows.items():
        if name in meta.image_keys:
            images = np.stack(
                [auto_downsample_height_width(values[t].transpose(2, 0, 1)) for t in sample_indices(len(values))]
            )
            found = get_feature_stats(images, axis=(0, 2, 3), keepdims=True, quantile_list=DEFAULT_QUANTILES)
            stats[name] = {key: v if key == "count" else np.squeeze(v / 255.0, axis=0) for key, v in found.items()}
        else:
            stats[name] = get_feature_stats(values, axis=0, keepdims=values.ndim == 1, quantile_list=DEFAULT_QUANTILES)
    return stats
