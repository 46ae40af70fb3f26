"""Checks demonstrations before anything is learned from them: what would fail or mislead later fails here."""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import ACTION, STATE, DatasetError

from .cameras import chosen_cameras, frame_size, used_size
from .dataset import AnyDataset, LocalDataset
from .frames import cached_frames
from .tables import FrameTable, read_table

logger = logging.getLogger(__name__)

TIME_TOLERANCE_S = 1e-4  # LeRobot's own tolerance between a row's timestamp and its video frame
CONSTANT_RANGE = 1e-6  # a dimension that moves less carries no information at float32 precision
BLACK_LEVEL = 8  # a camera whose brightest pixel stays below saw nothing (of 255)
_MISSING = (
    "name others in the settings, or record them (--representation.cameras names cameras, --rename_map tells what has "
    "another name, --representation.proprioception='[]' does without a state)"
)
SAMPLED_FRAMES = 64  # frames per camera looked at for blackness


def check_demonstrations(
    dataset: AnyDataset,
    cameras: Sequence[str] | None = None,
    columns: Sequence[str] = (STATE, ACTION),
    cache_dir: Path | None = None,
    side: int | None = None,
) -> list[str]:
    """Refuses demonstrations that cannot be segmented, and warns about what looks broken but can be.

    Decodes the cameras into the frame store on the way, so that a damaged video is found before anything is trained.

    Args:
        dataset: What stands for the dataset; its chosen episodes are checked.
        cameras: RGB cameras that will be used; all image features where None.
        columns: Vectors that will be used.
        cache_dir: Folder of the frame store; in LeRobot's home where None.
        side: Side of the squares (pixels) at which the frames will be used; as they are stored where None.

    Returns:
        The warnings, which are also logged: constant dimensions and black cameras by name.

    Raises:
        DatasetError: Features are missing (all are named); cameras are no RGB cameras; rows are missing; values are not
            finite; timestamps are not ``frame_index / fps``; the frame rate is absurd; a video is damaged or too short.
    """
    local = LocalDataset.of(dataset)
    cameras = chosen_cameras(local.features, None if cameras is None else list(cameras), "--representation.cameras")
    local.require([*cameras, *columns], _MISSING)
    sizes = {camera: used_size(frame_size(local.features[camera], camera), side) for camera in cameras}
    require_videos(local)
    table = read_table(local, [*columns, "timestamp", "frame_index", "episode_index"])
    require_whole(table)
    _check_clock(table)
    warnings = []
    for name in columns:
        names = dimension_names(local.features[name])
        require_finite(table, name, names)
        still = np.flatnonzero(np.ptp(_as_matrix(table, name), axis=0) < CONSTANT_RANGE)
        warnings += [f"{local.root}: {name!r} dimension {d} ({names[d]!r}) is constant in all frames" for d in still]
    for camera, size in sizes.items():
        frames = cached_frames(local, camera, cache_dir, size)
        sample = table.rows[np.unique(np.linspace(0, len(table.rows) - 1, SAMPLED_FRAMES).astype(np.int64))]
        if frames[sample].max() < BLACK_LEVEL:
            warnings.append(f"{local.root}: camera {camera!r} is black in all sampled frames")
    for warning in warnings:
        logger.warning("%s", warning)
    return warnings


def require_whole(table: FrameTable) -> None:
    """Refuses an empty dataset, an empty episode and a partial download.

    Args:
        table: Any table of the dataset.

    Raises:
        DatasetError: There are no rows, an episode has none, or one is not there; names the first one.
    """
    rows = table.rows
    if len(rows) == 0:
        raise DatasetError(f"{table.root} holds no frames: record or download demonstrations first.")
    empty = np.flatnonzero(table.starts == table.ends)
    if len(empty):
        raise DatasetError(
            f"{table.root}: episode {table.numbers[empty[0]]} has no frames, nor have {len(empty) - 1} more. "
            "LeRobot cannot load such a dataset; record it again without them."
        )
    absent = rows[~table.present[rows]]
    if len(absent):
        first = table.locate(int(absent[0]))
        raise DatasetError(
            f"{table.root}: {len(absent)} of {len(rows)} rows are not on this machine, the "
            f"first is {first}. Download the whole dataset."
        )


def require_videos(dataset: LocalDataset) -> None:
    """Refuses a dataset that lacks video files, even of cameras that nobody will look at: LeRobot would download them.

    Args:
        dataset: The dataset; those of its chosen episodes count.

    Raises:
        DatasetError: A video file is not there; names the first one and its episode.
    """
    for camera in (name for name, feature in dataset.features.items() if feature["dtype"] == "video"):
        absent = [record for record in dataset.episodes if not dataset.video_path(record, camera).exists()]
        if absent:
            raise DatasetError(
                f"{dataset.video_path(absent[0], camera)} is not there: episode {absent[0]['episode_index']} has "
                f"{absent[0]['length']} rows but 0 frames of {camera!r}, and {len(absent) - 1} more episode(s) lack "
                "theirs. Download the whole dataset."
            )


def require_finite(table: FrameTable, column: str, names: Sequence[str]) -> None:
    """Refuses NaN and infinities.

    Args:
        table: Table with the column.
        column: Name of a float column, ``(N,)`` or ``(N, D)``.
        names: D names of its dimensions.

    Raises:
        DatasetError: A present row is not finite; names episode, frame and dimension of the first one.
    """
    values = _as_matrix(table, column)
    bad = ~np.isfinite(values) & table.present[table.rows, None]
    if bad.any():
        place, dim = (int(i) for i in np.argwhere(bad)[0])
        row = int(table.rows[place])
        raise DatasetError(
            f"{table.root}: {column!r} is {values[place, dim]} in {table.locate(row)}, dimension {dim} "
            f"({names[dim]!r}); {int(bad.any(axis=1).sum())} frame(s) are affected. Repair the recording, or "
            "remove these episodes with lerobot-edit-dataset."
        )


def dimension_names(feature: dict[str, Any]) -> list[str]:
    """Lists one name per dimension of a vector feature, whichever way the dataset spells them.

    Args:
        feature: Feature record of ``meta/info.json``; its names may be a list, a dictionary of lists, or absent.

    Returns:
        The names; the dimensions' numbers where the dataset has no, or not one per dimension.
    """
    names, size = feature.get("names") or [], int(feature["shape"][0])
    if isinstance(names, dict):
        names = [name for group in names.values() for name in (group if isinstance(group, list) else [])]
    return [str(name) for name in names] if len(names) == size else [str(d) for d in range(size)]


def _as_matrix(table: FrameTable, column: str) -> NDArray[np.float64]:
    """Takes a column's rows of the chosen episodes as numbers, ``(M, D)``, whatever their type is."""
    return table.columns[column][table.rows].reshape(len(table.rows), -1).astype(np.float64)


def _check_clock(table: FrameTable) -> None:
    lengths, rows = table.ends - table.starts, table.rows
    expected = rows - np.repeat(table.starts, lengths)
    for column, truth in (("episode_index", np.repeat(table.numbers, lengths)), ("frame_index", expected)):
        wrong = np.flatnonzero(table.columns[column][rows] != truth)
        if len(wrong):
            row = int(rows[wrong[0]])
            raise DatasetError(
                f"{table.root}: {column} is {table.columns[column][row]} in {table.locate(row)}, which should be "
                f"{truth[wrong[0]]}. The rows do not fit meta/episodes; fetch or record the dataset again."
            )
    times = expected / table.fps
    # From 2,048 s on float32, in which LeRobot stores them, holds times less exactly than its own tolerance.
    tolerance = np.maximum(TIME_TOLERANCE_S, np.spacing(times.astype(np.float32)))
    late = np.flatnonzero(~(np.abs(table.columns["timestamp"][rows] - times) <= tolerance))
    if len(late):
        row = int(rows[late[0]])
        raise DatasetError(
            f"{table.root}: the timestamp of {table.locate(row)} is {table.columns['timestamp'][row]:.6f} s, but "
            f"frame_index / fps is {times[late[0]]:.6f} s (fps {table.fps:g}). Re-record at a constant "
            "rate, or correct fps in meta/info.json."
        )
