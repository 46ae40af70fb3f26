"""What a layout is: where a kind of file keeps its demonstrations, and how the kind is told."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import h5py
import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import DatasetError

STATES = "states"
"""Array of the simulator's states, in every layout of robosuite's."""


@dataclass(frozen=True)
class Layout:
    """Where a kind of file keeps what.

    Attributes:
        name: The layout's name.
        fits: Tells from ``data`` and from one demonstration whether a file is of this kind.
        prefix: What the names of demonstrations start with, before their number.
        group: Path from a demonstration to its observations: empty, or with a slash at the end.
        cameras: Camera -> image array.
        state: Vector arrays that make up the state.
        names: Vector array -> names of its dimensions, where these are known.
        leading: Arrays of which only so many leading dimensions are used.
        pooled: Images of all demonstrations lie one after another, directly below ``data``.
        late: The observation in a row is the one after the action of that row.
        orientation: Tells from ``data`` how its images are to be turned; None where it does not say.
        stages: Computes the true stages of demonstrations, where files of this kind tell them.
    """

    name: str
    fits: Callable[[h5py.Group, h5py.Group], bool]
    cameras: Mapping[str, str]
    state: tuple[str, ...]
    names: Mapping[str, list[str]]
    prefix: str = "demo_"
    group: str = "obs/"
    leading: Mapping[str, int] = field(default_factory=dict)
    pooled: bool = False
    late: bool = False
    orientation: Callable[[h5py.Group], str | None] = lambda _: "stored"
    stages: "Callable[[h5py.Group, list[str]], Stages] | None" = None


@dataclass(frozen=True)
class Stages:
    """The true stages of a file's demonstrations.

    Attributes:
        names: What they are called.
        of: ``(T,)`` int64 by the demonstration's name, a row of the file each.
    """

    names: tuple[str, ...]
    of: dict[str, NDArray[np.int64]]


def data_of(file: h5py.File, path: object) -> h5py.Group:
    """Finds the group that holds demonstrations.

    Raises:
        DatasetError: There is none.
    """
    data = file.get("data")
    if not isinstance(data, h5py.Group):
        raise DatasetError(
            f"{path} holds no demonstration: there is no group 'data', in which data/demo_<number> or "
            "data/ep_<number> lie. Name another file with --source."
        )
    return data


def demonstration_names(data: h5py.Group, prefix: str) -> list[str]:
    """Lists the demonstrations of a file in the order of their numbers, in which 10 comes after 2.

    Raises:
        DatasetError: One of them is an array.
    """
    skip = len(prefix)
    names = [name for name in data if name.startswith(prefix) and name[skip:].isdecimal()]
    for name in names:
        if not isinstance(data[name], h5py.Group):
            raise DatasetError(
                f"{data.file.filename}: {data.name}/{name} is an array of shape {data[name].shape}; wanted is a group "
                "of arrays, one of them 'actions'. Repair the file, or name another with --source."
            )
    return sorted(names, key=lambda name: int(name[skip:]))
