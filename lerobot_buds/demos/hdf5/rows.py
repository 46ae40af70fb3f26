"""Finds the rows of every demonstration in the arrays of a file, and pairs observations with actions."""

import logging
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import h5py
import numpy as np

from lerobot_buds.core import ACTION, IMAGE_PREFIX, DatasetError, near_names

from .layout import Layout, data_of, demonstration_names
from .source import Source

logger = logging.getLogger(__name__)


class Rows(NamedTuple):
    """The rows ``[start, stop)`` of an array that belong to one demonstration."""

    array: h5py.Dataset
    start: int
    stop: int


Demonstration = dict[str, Rows]
"""Aligned rows by ``action``, the names of the state's arrays, and the cameras' feature names."""


def rows_of(file: h5py.File, layout: Layout, source: Source) -> dict[str, Demonstration]:
    """Finds the rows of every selected demonstration, by its name in the file.

    The order is that of the numbers in the names. (h5py's own, in which 10 comes before 2, is not that of the images.)
    Of a late layout, an episode's first action and last observation are dropped.

    Raises:
        DatasetError: Nothing is selected; arrays are missing (all are named) or of unequal lengths.
    """
    every = demonstration_names(data_of(file, source.path), layout.prefix)
    selected = selected_names(file, layout, source)
    names = every if layout.pooled else selected
    cameras = cameras_of(file, layout, source)
    paths = {name: _paths(layout, source, cameras, name) for name in names}
    require_arrays(file, layout.name, source, sorted({path for arrays in paths.values() for path in arrays.values()}))
    lengths = {name: len(file[paths[name][ACTION]]) for name in names}
    late = int(layout.late and source.alignment == "lerobot")
    short = [name for name, length in lengths.items() if length <= late]
    if short:
        raise DatasetError(
            f"{source.path}: {', '.join(short)} have no frame to import. Leave them out, or repair them."
        )
    total, begin = sum(lengths.values()), 0  # begin: an episode's first row in the pooled images
    demonstrations: dict[str, Demonstration] = {}
    for name, length in lengths.items():
        demonstrations[name] = demonstration = {}
        for key, path in paths[name].items():
            pooled = layout.pooled and key.startswith(IMAGE_PREFIX)
            actions, where = (total, "the file") if pooled else (length, name)
            if len(file[path]) != actions:
                raise DatasetError(
                    f"{source.path}: {path} has {len(file[path])} rows, but {where} has {actions} actions. Frames are "
                    "missing: fetch the file again, or repair it."
                )
            first = begin if pooled else late if key == ACTION else 0
            demonstration[key] = Rows(file[path], first, first + length - late)
        begin += length
    return {name: demonstrations[name] for name in selected}


def selected_names(file: h5py.File, layout: Layout, source: Source) -> list[str]:
    """Lists the demonstrations to read, in the order of their numbers.

    Raises:
        DatasetError: The filter selects none, or a demonstration is no group.
    """
    every = demonstration_names(data_of(file, source.path), layout.prefix)
    if source.filter_key is None:
        return every
    known: dict[str, set[str]] = {}
    if layout.pooled:
        tasks = file["data/task"].attrs if "data/task" in file else {}
        known = {key: {f"{layout.prefix}{number}" for number in np.ravel(tasks[key])} for key in tasks}
    else:
        masks = file.get("mask")
        for key, names in masks.items() if isinstance(masks, h5py.Group) else ():
            values = np.ravel(names[()]) if isinstance(names, h5py.Dataset) else ()
            known[key] = {name.decode() if isinstance(name, bytes) else str(name) for name in values}
    known = {key: names.intersection(every) for key, names in known.items()}
    key = str(source.filter_key)
    if not known.get(key):
        raise DatasetError(f"{source.path}: filter_key={key!r} selects nothing. {near_names(key, known)}")
    return [name for name in every if name in known[key]]


def state_of(layout: Layout, source: Source) -> list[str]:
    """Lists the arrays that make up the state: those asked for, which may be none, or the layout's own."""
    return list(layout.state if source.state is None else source.state)


def cameras_of(file: h5py.File, layout: Layout, source: Source) -> dict[str, str]:
    """Lists the image array of each camera: those asked for, which may be none, or the layout's own.

    A file without a single array of images is one of states and vectors alone, which has no cameras.
    """
    if source.cameras is not None:
        return dict(source.cameras)
    if not layout.pooled:
        first = selected_names(file, layout, source)[0]
        observations = file.get(f"data/{first}/{layout.group}".rstrip("/"))
        if isinstance(observations, h5py.Group) and not any(len(_shape(array)) > 2 for array in observations.values()):
            logger.info("%s: there are no images; the dataset will have no cameras.", source.path)
            return {}
    return dict(layout.cameras)


def _paths(layout: Layout, source: Source, cameras: Mapping[str, str], name: str) -> dict[str, str]:
    inside = f"data/{name}/{layout.group}"
    images = "data/" if layout.pooled else inside
    return {
        ACTION: f"data/{name}/actions",
        **{key: inside + key for key in state_of(layout, source)},
        **{IMAGE_PREFIX + camera: images + key for camera, key in cameras.items()},
    }


def require_arrays(file: h5py.File, layout: str, source: Source, paths: Sequence[str]) -> None:
    """Refuses a file that lacks arrays.

    Args:
        file: The file.
        layout: Name of its layout.
        source: Where it lies.
        paths: The arrays.

    Raises:
        DatasetError: At least one is absent, a group, or a single number; all are named.
    """
    lacking: dict[str, list[str]] = {}
    for path in paths:
        if not _shape(file.get(path)):
            lacking.setdefault(path.rpartition("/")[2], []).append(path)
    if lacking:
        lines = [_missing(file, key, where) for key, where in lacking.items()]
        raise DatasetError(
            f"{source.path} lacks {len(lines)} array(s) of the {layout} layout:\n" + "\n".join(lines) + "\n"
            "Name other arrays with --cameras and --state. A file of simulator states alone has to be rendered first: "
            "here, if demonstrations have the attribute model_file, or by robomimic's dataset_states_to_obs.py."
        )


def _shape(found: Any) -> tuple[int, ...]:
    return tuple(found.shape) if isinstance(found, h5py.Dataset) and found.shape else ()


def _missing(file: h5py.File, key: str, where: list[str]) -> str:
    inside = where[0].rpartition("/")[0]
    parent = file.get(inside)
    more = f" and {len(where) - 1} more" if len(where) > 1 else ""
    if isinstance(parent, h5py.Dataset):
        return f"  {where[0]!r}{more}: {inside!r} is an array of shape {parent.shape}, not a group of arrays."
    return f"  {where[0]!r}{more}: {near_names(key, parent if parent is not None else ())}"
