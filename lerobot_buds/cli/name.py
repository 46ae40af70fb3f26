"""``lerobot-buds-name``: names the skills of a segmented dataset, and writes them into it as LeRobot's subtasks."""

from dataclasses import dataclass
from pathlib import Path

from lerobot_buds.core import NAMES_FILE, ConfigError

from .running import dataset_root, parse, run


@dataclass
class NameConfig:
    """Settings of naming; the dataset is changed in place."""

    repo_id: str | None = None
    """The segmented dataset; only its place is taken from it."""

    root: Path | None = None
    """Its folder; None for LeRobot's own place for `repo_id`."""

    names: Path | None = None
    """File of names. One that does not exist is written, to be edited; one that does is applied. None for the dataset's
    own, ``meta/buds/names.yaml``."""

    replace: bool = False
    """Replaces subtasks that are not of the dataset's segments, those of people for example."""


def name_skills(config: NameConfig) -> tuple[Path, bool]:
    """Applies a file of names to a segmented dataset; where the file does not exist, writes it instead.

    Returns:
        The file, and whether it was applied.

    Raises:
        ConfigError: No dataset is named.
        SegmentationError: The dataset is not segmented, or the names cannot be used.
        DatasetError: The dataset is damaged or incomplete, or another process is writing it.
        StorageError: It cannot be written; it is as it was.
    """
    from lerobot_buds.data import LocalDataset
    from lerobot_buds.segmentation import (
        SegmentationRecord,
        automatic_names,
        names_of,
        read_names,
        write_card,
        write_names,
        write_subtasks,
    )

    if config.root is None and config.repo_id is None:
        raise ConfigError("Which dataset? Give its folder with --root, or its name with --repo_id.")
    root = dataset_root(config.repo_id or "", config.root)
    record = SegmentationRecord.read(root)
    path = root / NAMES_FILE if config.names is None else Path(config.names)
    if not path.exists():
        write_names(path, names_of(root, record.n_skills) or automatic_names(record, LocalDataset(root)))
        return path, False
    write_subtasks(root, read_names(path, record.n_skills), config.replace)
    write_card(root, config.repo_id or root.name)
    return path, True


def main() -> None:
    """Entry point of the console script."""
    config = parse(NameConfig)
    path, applied = run(lambda: name_skills(config))
    if applied:
        print(f"The segments are subtasks of the dataset now, named as in {path}.")
    else:
        print(f"Wrote {path}: edit the names, and run the same command again to apply them.")
