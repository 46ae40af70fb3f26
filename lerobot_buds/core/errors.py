"""The errors of this package: each says what is wrong, where, why, and what to do about it."""

from collections.abc import Iterable
from difflib import get_close_matches


class BudsError(Exception):
    """Base of every error that this package raises on purpose."""


class ConfigError(BudsError, ValueError):
    """A setting has a value that cannot work."""


class DatasetError(BudsError):
    """A dataset is damaged, incomplete, or not what the caller takes it for."""


class SegmentationError(BudsError):
    """Demonstrations cannot be segmented as asked, or stored labels do not fit their dataset."""


class CheckpointError(BudsError):
    """A checkpoint does not fit the data, the environment or the skill library it is used with."""


class StorageError(BudsError, OSError):
    """A file cannot be written: the disk is full, the folder is read-only, or is no folder."""


class SimulatorError(BudsError):
    """The simulator is missing, of an unsupported version, or failed while running."""


def near_names(name: str, known: Iterable[str]) -> str:
    """Describes the known names, near matches first, for the end of an error message.

    Args:
        name: The name that was not found.
        known: All names that would have been accepted.

    Returns:
        For example ``"Did you mean 'kitchen'? Known: 'hammer', 'kitchen'."``
    """
    names = sorted(set(known))
    near = get_close_matches(name, names, n=3, cutoff=0.5)
    listing = ", ".join(repr(n) for n in near + [n for n in names if n not in near]) or "none"
    guess = f"Did you mean {near[0]!r}? " if near else ""
    return f"{guess}Known: {listing}."
