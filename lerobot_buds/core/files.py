"""Files that are either whole or absent: everything is written beside its target and renamed into place."""

import glob
import json
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

from .errors import BudsError, StorageError

DISTRIBUTION = "lerobot_policy_buds"
"""Name of this package as it is installed; underscores included, LeRobot finds it by them."""


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Creates or replaces one file so that a reader, or a kill, never sees half of it.

    Args:
        path: The file to create or replace; its folder is created where missing.
        write: Called with the temporary path that it must fill.

    Raises:
        StorageError: The file cannot be written; what was there before still is.
    """
    part = _part_of(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            write(part)
            _sync(part)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise StorageError(
            f"{path} could not be written ({error}); nothing was left behind. Make room on its disk, or choose a "
            "folder that can be written."
        ) from error


def write_json(path: Path, content: Any) -> None:
    """Writes plain data as indented JSON with sorted keys, atomically; NaN and infinities are refused."""
    text = json.dumps(content, indent=2, sort_keys=True, allow_nan=False) + "\n"
    write_atomically(path, lambda part: part.write_text(text, encoding="utf-8"))


def read_json(path: Path) -> Any:
    """Reads a JSON file.

    Raises:
        FileNotFoundError: The file does not exist.
        json.JSONDecodeError: The file is not JSON.
    """
    return json.loads(path.read_text(encoding="utf-8"))


@contextmanager
def storage_errors(target: Path, remedy: str) -> Iterator[None]:
    """Says what a failure to write means, where libraries write that know nothing of errors of this package.

    Args:
        target: What is being written.
        remedy: What is left, and what to do about it, for the message.

    Raises:
        StorageError: The block could not write; errors that say so already pass.
    """
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        raise StorageError(f"{target} could not be written ({error}). {remedy}") from error


@contextmanager
def staged_directory(target: Path) -> Iterator[Path]:
    """Builds a directory beside `target` and renames it into place when the block ends without an error.

    Args:
        target: The directory to create. It must not exist, or be empty.

    Yields:
        A path of the same parent folder, which does not exist yet; the block creates and fills it. It is removed if the
        block raises.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    staging = _part_of(target)
    try:
        yield staging
        staging.replace(target)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


@contextmanager
def replaced_together() -> Iterator[Callable[[Path], Path]]:
    """Replaces several files of which none is of use without the others: all are written first, then all are renamed.

    A kill within the renames, a moment, leaves some of them old; whoever writes all of them again mends it.

    Yields:
        A function that takes a file to create or replace and returns the path to write its content to.

    Raises:
        StorageError: A file cannot be written; all are as they were.
    """
    parts: dict[Path, Path] = {}

    def part_of(target: Path) -> Path:
        target.parent.mkdir(parents=True, exist_ok=True)
        return parts.setdefault(target, _part_of(target))

    try:
        try:
            yield part_of
            for part in parts.values():
                _sync(part)
            for target, part in parts.items():
                part.replace(target)
        finally:
            for part in parts.values():
                part.unlink(missing_ok=True)
    except OSError as error:
        raise StorageError(
            f"{', '.join(map(str, parts))} could not be written ({error}). Make room on the disk, or choose a folder "
            "that can be written."
        ) from error


def remove_leftovers(folder: Path, name: str = "*") -> None:
    """Removes what writers that were killed left in a folder. Only for who keeps all other writers away by a lock.

    Args:
        folder: Where the targets lie, or would.
        name: Name of the target, the leftovers of all targets by default.
    """
    literal = name if name == "*" else glob.escape(name)
    for leftover in folder.glob(f".{literal}.{'[0-9a-f]' * 8}.part"):
        if leftover.is_dir():
            shutil.rmtree(leftover)
        else:
            leftover.unlink()


def refuse_newer(path: Path, found: Any, known: int, writer: Any, error: type[BudsError]) -> None:
    """Refuses one of this package's own files if a later version wrote it in a format that is not known here.

    Args:
        path: The file, for the message.
        found: The number of its format; nothing is said about what is no number.
        known: The newest format that can be read.
        writer: Version of the package that wrote it.
        error: Class of the error to raise.
    """
    if isinstance(found, int) and found > known:
        raise error(
            f"{path} has format {found}, this version of {DISTRIBUTION} reads up to {known}. "
            f"Install {DISTRIBUTION}>={writer}."
        )


def sha256_of_file(path: Path) -> str:
    """Hashes a file's content, as a hexadecimal string."""
    digest = sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def sha256_of_json(content: Any) -> str:
    """Hashes plain data by its canonical JSON, as a hexadecimal string; names caches by what determines them."""
    return sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode()).hexdigest()


def _part_of(target: Path) -> Path:
    return target.with_name(f".{target.name}.{uuid.uuid4().hex[:8]}.part")


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())
