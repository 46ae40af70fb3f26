"""The settings that name a dataset, the same in every command that reads one."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from .running import dataset_root

if TYPE_CHECKING:
    from lerobot_buds.data import LocalDataset


@dataclass
class DatasetOptions:
    """Which dataset, and what of it."""

    repo_id: str
    """The dataset; it is only read."""

    root: Path | None = None
    """Its folder; None for LeRobot's own place for `repo_id`, where it is downloaded if it is missing."""

    revision: str | None = None
    """Branch, tag or commit to download; LeRobot's own version tag where None."""

    episodes: list[int] | None = None
    """Episodes to use, by number; all where None."""

    rename_map: dict[str, str] = field(default_factory=dict)
    """Name of a feature in the dataset -> name to use for it, for what was trained under that name."""

    video_backend: str | None = None
    """LeRobot's decoder of videos, ``torchcodec`` or ``pyav``; its default where None."""

    def open(self) -> "LocalDataset":
        """Finds the dataset on this machine, after downloading it where it is missing and has no folder given.

        Raises:
            DatasetError: It is not on this machine and cannot be had from the Hub, or is no LeRobotDataset.
        """
        from lerobot_buds.data import LocalDataset, download_dataset

        place = dataset_root(self.repo_id, self.root)
        if self.root is None and (self.revision is not None or not (place / "meta" / "info.json").exists()):
            place = download_dataset(self.repo_id, self.revision, self.episodes)
        chosen = None if self.episodes is None else tuple(self.episodes)
        dataset = LocalDataset(place, chosen, self.rename_map, self.video_backend, self.revision, self.repo_id)
        _ = dataset.info  # LeRobot would look for a folder that does not exist on the Hub, under its last name
        return dataset
