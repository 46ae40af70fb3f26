"""The record of how demonstrations came about: its version, and how it is read again."""

from pathlib import Path
from typing import Any

from lerobot_buds.core import COLLECTION_FILE, DISTRIBUTION, DatasetError, read_json, refuse_newer

RECORD_VERSION = 2
"""Raised whenever the record's meaning changes; older records are read, newer ones refused."""


def read_collection(root: Path) -> dict[str, Any]:
    """Reads the record of recorded or imported demonstrations; empty where the dataset has none.

    Args:
        root: Folder of a dataset.

    Raises:
        DatasetError: The record is damaged, or of a newer version than this package knows.
    """
    path = Path(root) / COLLECTION_FILE
    try:
        record = read_json(path)
    except FileNotFoundError:
        return {}
    except ValueError as error:
        raise DatasetError(f"{path} is damaged ({error}); fetch the dataset again, or remove the file.") from error
    if not isinstance(record, dict):
        raise DatasetError(f"{path} is damaged (no record); fetch the dataset again, or remove the file.")
    refuse_newer(
        path, record.get("version"), RECORD_VERSION, record.get("versions", {}).get(DISTRIBUTION), DatasetError
    )
    return record
