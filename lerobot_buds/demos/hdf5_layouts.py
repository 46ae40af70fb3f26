"""Where HDF5 files keep demonstrations: robomimic's layout and that of the original BUDS release.

Both keep one group a demonstration below ``data``. They differ in where images lie and in what a row pairs:

- robomimic: ``data/demo_N/actions`` and ``data/demo_N/obs/<array>``. Observation t is the one that action t followed.
- buds (what the release's ``create_demonstration_dataset.py`` writes): ``data/ep_N/{actions, joint_states, ...}``. The
  images of all episodes lie one after another, channels first, in ``data/agentview_images`` and
  ``data/eye_in_hand_images``. Observation j is the one *after* action j.

Here every demonstration's rows are found and aligned; what is in them is read elsewhere.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from lerobot_buds.core import ACTION, IMAGE_PREFIX, ConfigError, DatasetError, near_names
from lerobot_buds.envs import STATE_NAMES

ALIGNMENTS = ("lerobot", "released")


@dataclass(frozen=True)
class Layout:
    """Where a kind of file keeps what.

    Attributes:
        name: The layout's name.
        prefix: What the names of demonstrations start with, before their number.
        group: Path from a demonstration to its observations: empty, or with a slash at the end.
        cameras: Camera -> image array.
        state: Vector arrays that make up the state -> names of their dimensions.
        leading: Arrays of which only so many leading dimensions are used.
        pooled: Images of all demonstrations lie one after another, directly below ``data``.
        late: The observation in a row is the one after the action of that row.
    """

    name: str
    prefix: str
    group: str
    cameras: dict[str, str]
    state: dict[str, list[str]]
    leading: dict[str, int] = field(default_factory=dict)
    pooled: bool = False
    late: bool = False


ROBOMIMIC = Layout(
    name="robomimic",
    prefix="demo_",
    group="obs/",
    cameras={"agentview": "agentview_image", "eye_in_hand": "robot0_eye_in_hand_image"},
    state={
        "robot0_joint_pos": STATE_NAMES[:7],
        "robot0_gripper_qpos": STATE_NAMES[7:9],
        "robot0_eef_pos": STATE_NAMES[9:],
    },
)
BUDS = Layout(
    name="buds",
    prefix="ep_",
    group="",
    cameras={"agentview": "agentview_images", "eye_in_hand": "eye_in_hand_images"},
    state={"joint_states": STATE_NAMES[:7], "gripper_states": STATE_NAMES[7:9], "proprio_states": STATE_NAMES[9:]},
    leading={"proprio_states": 3},  # the hand's position; behind it the fingers again, or the hand's rotation
    pooled=True,
    late=True,
)
LAYOUTS = {layout.name: layout for layout in (ROBOMIMIC, BUDS)}


@dataclass(frozen=True)
class Source:
    """Which demonstrations of which file are read, and how.

    Attributes:
        path: The HDF5 file.
        layout: A key of `LAYOUTS`; None to tell by the names in the file.
        cameras: Camera -> image array; None for the layout's own.
        state: Vector arrays that make up the state, in this order; None for the layout's own.
        alignment: ``lerobot`` pairs an observation with the action that followed it; ``released`` pairs rows as the
            BUDS release stored and learned them, only for comparisons with it.
        flip: Turns images upside down, for files that keep OpenGL's order (bottom row first). Neither layout does:
            robomimic flips before it stores, and the release was rendered with robosuite's "opencv" convention.
        filter_key: Reads only these demonstrations: a name in robomimic's ``mask``, or a task number of the release's
            multi-task file (an attribute of ``data/task``). None for all.
    """

    path: Path
    layout: str | None = None
    cameras: Mapping[str, str] | None = None
    state: Sequence[str] | None = None
    alignment: str = "lerobot"
    flip: bool = False
    filter_key: str | None = None


class Rows(NamedTuple):
    """The rows ``[start, stop)`` of an array that belong to one demonstration."""

    array: h5py.Dataset
    start: int
    stop: int


Demonstration = dict[str, Rows]
"""Aligned rows by ``action``, the names of the state's arrays, and the cameras' feature names."""


def layout_of(file: h5py.File, source: Source) -> Layout:
    """Tells the layout, with the source's own arrays in place of the usual ones.

    Raises:
        ConfigError: The layout or the alignment is unknown, or they do not go together.
        DatasetError: The file is in no known layout, or not in the one asked for.
    """
    if source.layout is not None and source.layout not in LAYOUTS:
        raise ConfigError(f"layout={source.layout!r} is unknown. {near_names(source.layout, LAYOUTS)}")
    wanted = [LAYOUTS[source.layout]] if source.layout else list(LAYOUTS.values())
    layout = next((layout for layout in wanted if _names(file, layout)), None)
    if layout is None:
        groups = " or ".join(f"data/{layout.prefix}<number> ({layout.name})" for layout in wanted)
        raise DatasetError(f"{source.path} holds no demonstration: no group is named {groups}.")
    if source.alignment not in ALIGNMENTS:
        raise ConfigError(f"alignment={source.alignment!r} is unknown. {near_names(source.alignment, ALIGNMENTS)}")
    if source.alignment == "released" and not layout.late:
        raise ConfigError(f"alignment='released' means nothing for the {layout.name} layout; leave it at 'lerobot'.")
    return layout


def rows_of(file: h5py.File, layout: Layout, source: Source) -> dict[str, Demonstration]:
    """Finds the rows of every selected demonstration, by its name in the file.

    The order is that of the numbers in the names. (h5py's own, in which 10 comes before 2, is not that of the images.)
    Of a late layout, an episode's first action and last observation are dropped.

    Raises:
        DatasetError: Nothing is selected; arrays are missing (all are named) or of unequal lengths.
    """
    every = _names(file, layout)
    selected = every if source.filter_key is None else _filtered(file, layout, source, every)
    names = every if layout.pooled else selected
    paths = {name: _paths(layout, source, name) for name in names}
    _require(file, layout, source, sorted({path for arrays in paths.values() for path in arrays.values()}))
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


def _names(file: h5py.File, layout: Layout) -> list[str]:
    skip, data = len(layout.prefix), file.get("data")
    names = [
        name
        for name in (data if isinstance(data, h5py.Group) else ())
        if name.startswith(layout.prefix) and name[skip:].isdecimal()
    ]
    return sorted(names, key=lambda name: int(name[skip:]))


def _filtered(file: h5py.File, layout: Layout, source: Source, every: list[str]) -> list[str]:
    known: dict[str, set[str]] = {}
    if layout.pooled:
        tasks = file["data/task"].attrs if "data/task" in file else {}
        known = {key: {f"{layout.prefix}{number}" for number in np.ravel(tasks[key])} for key in tasks}
    else:
        masks = file.get("mask", {})
        known = {key: {str(name, "utf-8") for name in masks[key][()]} for key in masks}
    known = {key: names.intersection(every) for key, names in known.items()}
    key = str(source.filter_key)
    if not known.get(key):
        raise DatasetError(f"{source.path}: filter_key={key!r} selects nothing. {near_names(key, known)}")
    return [name for name in every if name in known[key]]


def _paths(layout: Layout, source: Source, name: str) -> dict[str, str]:
    inside = f"data/{name}/{layout.group}"
    images = "data/" if layout.pooled else inside
    return {
        ACTION: f"data/{name}/actions",
        **{key: inside + key for key in source.state or layout.state},
        **{IMAGE_PREFIX + camera: images + key for camera, key in (source.cameras or layout.cameras).items()},
    }


def _require(file: h5py.File, layout: Layout, source: Source, paths: list[str]) -> None:
    lacking: dict[str, list[str]] = {}
    for path in paths:
        if not getattr(file.get(path), "shape", None):  # absent, a group, or a single number
            lacking.setdefault(path.rpartition("/")[2], []).append(path)
    if lacking:
        lines = [_missing(file, key, where) for key, where in lacking.items()]
        raise DatasetError(
            f"{source.path} lacks {len(lines)} array(s) of the {layout.name} layout:\n" + "\n".join(lines) + "\n"
            "Name other arrays with --cameras and --state. A file of simulator states alone has to be rendered first "
            "(robomimic's dataset_states_to_obs.py)."
        )


def _missing(file: h5py.File, key: str, where: list[str]) -> str:
    parent: Any = file.get(where[0].rpartition("/")[0], {})
    more = f" and {len(where) - 1} more" if len(where) > 1 else ""
    return f"  {where[0]!r}{more}: {near_names(key, parent)}"
