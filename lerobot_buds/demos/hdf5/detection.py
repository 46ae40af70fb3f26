"""Tells which layout a file has, from the file itself."""

from typing import Any

import h5py

from lerobot_buds.core import ConfigError, DatasetError, near_names

from .buds import BUDS
from .layout import Layout, data_of, demonstration_names
from .libero import LIBERO
from .robomimic import MIMICGEN, ROBOCASA, ROBOMIMIC
from .robosuite import ROBOSUITE
from .source import ALIGNMENTS, ORIENTATIONS, Source

LAYOUTS: dict[str, Layout] = {
    layout.name: layout for layout in (LIBERO, ROBOCASA, MIMICGEN, ROBOMIMIC, ROBOSUITE, BUDS)
}
"""Layouts by name. Of several that fit a file the first is meant: the others would lose what it tells."""

_CONFLICTS = {LIBERO.name: {ROBOMIMIC.name, MIMICGEN.name, ROBOCASA.name}}
"""Layout -> others whose arrays it has too, but that would read them wrongly."""


def layout_of(file: h5py.File, source: Source) -> Layout:
    """Tells the layout of a file, and checks the settings that depend on it.

    Raises:
        ConfigError: The layout, the alignment or the orientation is unknown, or does not go with the file's layout.
        DatasetError: The file is in no known layout, in two at once, or not in the one asked for.
    """
    for name, value, known in (
        ("layout", source.layout, LAYOUTS),
        ("alignment", source.alignment, ALIGNMENTS),
        ("orientation", source.orientation, ORIENTATIONS),
    ):
        if value is not None and value not in known:
            raise ConfigError(f"{name}={value!r} is unknown. {near_names(value, known)}")
    layout = _chosen(file, source)
    if source.alignment == "released" and not layout.late:
        raise ConfigError(f"alignment='released' means nothing for the {layout.name} layout; leave it at 'lerobot'.")
    return layout


def _chosen(file: h5py.File, source: Source) -> Layout:
    data = data_of(file, source.path)
    prefixes = {layout.prefix for layout in LAYOUTS.values() if demonstration_names(data, layout.prefix)}
    fitting = [layout for layout in LAYOUTS.values() if layout.prefix in prefixes and _fits(layout, data)]
    if source.layout is None:
        if len(prefixes) > 1:
            raise DatasetError(
                f"{source.path} holds demonstrations named {' and '.join(sorted(prefixes))}<number>, of two layouts; "
                "say which are meant with --layout."
            )
        if fitting:
            return fitting[0]
        if prefixes:
            return ROBOMIMIC  # its error names what is missing
        raise DatasetError(_nothing(source, list(LAYOUTS.values())))
    wanted = LAYOUTS[source.layout]
    if wanted.prefix not in prefixes:
        raise DatasetError(_nothing(source, [wanted]))
    contradicting = [layout.name for layout in fitting if wanted.name in _CONFLICTS.get(layout.name, ())]
    if contradicting or (fitting and wanted not in fitting):
        names = contradicting or [layout.name for layout in fitting]
        raise DatasetError(
            f"{source.path} is of the layout {' or '.join(names)}, as its attributes and arrays say; read as "
            f"{wanted.name!r} it would be misread. Leave out --layout."
        )
    return wanted


def _fits(layout: Layout, data: h5py.Group) -> bool:
    first: Any = demonstration_names(data, layout.prefix)[0]
    return layout.fits(data, data[first])


def _nothing(source: Source, wanted: list[Layout]) -> str:
    prefixes = {layout.prefix: layout.name for layout in reversed(wanted)}
    groups = " or ".join(f"data/{prefix}<number> ({name})" for prefix, name in prefixes.items())
    return f"{source.path} holds no demonstration: no group is named {groups}."
