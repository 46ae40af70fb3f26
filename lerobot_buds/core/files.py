"""Files that are either whole or absent: everything is written beside its target and renamed into place."""

import json
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Creates or replaces one file so that a reader, or a kill, never sees half of it.

    Args:
        path: The file to create or replace; its folder is created where missing.
        write: Called with the temporary path that it must fill.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.part")
    try:
        write(part)
        _sync(part)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


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
def staged_directory(target: Path) -> Iterator[Path]:
    """Builds a directory beside `target` and renames it into place when the block ends without an error.

    Args:
        target: The directory to create. It must not exist, or be empty.

    Yields:
        A path of the same parent folder, which does not exist yet; the block creates and fills it. It is removed if the
        block raises.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    staging = target.with_name(f".{target.name}.{uuid.uuid4().hex[:8]}.part")
    try:
        yield staging
        staging.replace(target)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


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


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())
