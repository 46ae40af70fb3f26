"""Several files as one source: a folder of files, one a task, becomes one dataset."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lerobot_buds.core import DatasetError

from .source import Demonstrations

SUFFIXES = (".hdf5", ".h5")


def files_of(path: Path) -> list[Path]:
    """Lists the files of a source: itself, or the HDF5 files of a folder in the order of their names.

    Raises:
        DatasetError: There is nothing, or no HDF5 file in the folder.
    """
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file())
        if not files:
            raise DatasetError(f"{path} is a folder without HDF5 files ({', '.join(SUFFIXES)}); name another --source.")
        return files
    if not path.is_file():
        raise DatasetError(f"{path} does not exist; name the HDF5 file with --source.")
    return [path]


class JoinedDemonstrations:
    """The demonstrations of several opened files, one file after the other; see `Demonstrations`.

    Args:
        files: Where they lie; a demonstration is named by its file and its name in it.
        parts: What was opened of each.

    Raises:
        DatasetError: The files do not go into one dataset; names the first that differs, and in what.
    """

    def __init__(self, files: Sequence[Path], parts: Sequence[Demonstrations]) -> None:
        _require_alike(files, parts)
        first = parts[0]
        self.layout, self.fps, self.stages = first.layout, first.fps, first.stages
        self.state_names, self.action_names = first.state_names, first.action_names
        self.image_shapes = first.image_shapes
        environments = {part.environment for part in parts}
        self.environment = environments.pop() if len(environments) == 1 else None
        self._parts = {
            f"{file.stem}.{name}": (part, name)
            for file, part in zip(files, parts, strict=True)
            for name in part.lengths
        }
        self.lengths = {key: part.lengths[name] for key, (part, name) in self._parts.items()}
        self.instructions = {
            key: part.instructions[name] for key, (part, name) in self._parts.items() if name in part.instructions
        }
        self.facts: dict[str, Any] = {file.name: part.facts for file, part in zip(files, parts, strict=True)}

    def read(self, name: str) -> dict[str, NDArray[Any]]:
        """Reads one demonstration; see `Demonstrations.read`."""
        part, inside = self._parts[name]
        return part.read(inside)


def _require_alike(files: Sequence[Path], parts: Sequence[Demonstrations]) -> None:
    stems = [file.stem for file in files]
    if len(set(stems)) < len(stems):
        raise DatasetError(f"{files[0].parent} holds files of one name and two suffixes; remove or rename one.")
    for file, part in zip(files[1:], parts[1:], strict=True):
        for what in ("layout", "fps", "state_names", "action_names", "image_shapes", "stages"):
            mine, first = getattr(part, what), getattr(parts[0], what)
            if mine != first:
                raise DatasetError(
                    f"{file} and {files[0]} do not go into one dataset: {what} is {mine!r} here and {first!r} there. "
                    "Import them apart, or choose --cameras and --state that both have."
                )
