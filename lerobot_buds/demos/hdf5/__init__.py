"""Reads demonstrations from HDF5 files, opened read-only and checked as a whole before the first frame is read."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import h5py

from lerobot_buds.core import ConfigError, DatasetError

from .detection import LAYOUTS, layout_of
from .joined import JoinedDemonstrations, files_of
from .robosuite import ROBOSUITE, PlayedDemonstrations
from .source import Demonstrations, Source
from .stored import StoredDemonstrations

__all__ = ["LAYOUTS", "Demonstrations", "Source", "files_of", "open_demonstrations"]


@contextmanager
def open_demonstrations(source: Source) -> Iterator[Demonstrations]:
    """Opens a file, or all files of a folder, and checks all of it but the values of its pixels.

    Raises:
        ConfigError: A setting is unknown, or does not go with the layout.
        DatasetError: A file is missing, cut off or in no known layout; arrays are missing (all are named), of unequal
            lengths or of the wrong kind; values are not finite; files do not go into one dataset.
        SimulatorError: States are to be played back, but the simulator is missing or unsupported.
    """
    files = files_of(source.path)
    with ExitStack() as stack:
        parts = [_open(replace(source, path=file), stack) for file in files]
        yield JoinedDemonstrations(files, parts) if source.path.is_dir() else parts[0]


def _open(source: Source, stack: ExitStack) -> Demonstrations:
    path: Path = source.path
    try:
        file = stack.enter_context(h5py.File(path, "r"))
    except OSError as error:
        raise DatasetError(
            f"{path} cannot be opened ({error}). It is no HDF5 file, or was cut off: fetch it again."
        ) from error
    layout = layout_of(file, source)
    if layout.name == ROBOSUITE.name:
        played = PlayedDemonstrations(file, source)
        stack.callback(played.close)
        return played
    if source.resample is not None or source.uneven or source.assets is not None:
        raise ConfigError(
            f"resample, uneven and assets are for the robosuite layout, but {path} is of the layout {layout.name}."
        )
    return StoredDemonstrations(file, layout, source)
