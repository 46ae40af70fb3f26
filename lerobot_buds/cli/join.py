"""``lerobot-buds-join``: makes a segmented dataset of somebody's labels and the dataset that they are of."""

from dataclasses import dataclass
from pathlib import Path

from lerobot_buds.core import ConfigError

from .datasets import DatasetOptions
from .running import dataset_root, parse, run


@dataclass
class JoinConfig:
    """Which labels, and where their source is; both are only read."""

    repo_id: str | None = None
    """The labels' repository on the Hub."""

    root: Path | None = None
    """Their folder, where they are on this machine; also that of a segmented dataset."""

    revision: str | None = None
    """Branch, tag or commit of the labels; the main branch where None."""

    source_repo_id: str | None = None
    """The dataset that they are of; None for what the labels say."""

    source_root: Path | None = None
    """Its folder; None to fetch it where it is missing."""

    source_revision: str | None = None
    """Branch, tag or commit to fetch; None for the one that was labelled."""

    edited: bool = False
    """The source was edited after it was labelled, as by delete_episodes or merge of lerobot-edit-dataset: its episodes
    are found by what is in them."""

    output_repo_id: str | None = None
    """Name of the segmented dataset; None for the labels' with ``_joined`` behind it."""

    output_root: Path | None = None
    """Its folder, which must not exist; None for LeRobot's own place for its name."""


def join(config: JoinConfig) -> Path:
    """Joins labels with their source.

    Returns:
        The new dataset's folder.

    Raises:
        ConfigError: No labels are named.
        BudsError: Labels or source cannot be had, are damaged, or do not belong together; or the target exists or
            cannot be written.
    """
    from lerobot_buds.data import download
    from lerobot_buds.segmentation import COMPANION_FILES, SegmentationRecord, join_companion

    name = config.repo_id or (config.root.name if config.root else None)
    if name is None:
        raise ConfigError("Which labels? Give their repository with --repo_id, or their folder with --root.")
    labels = config.root or download(name, COMPANION_FILES, config.revision, repo_type="dataset")
    source = SegmentationRecord.read(labels).source
    # What is fetched is as it was labelled; what is there already is told by the hashes of its rows.
    wanted = None if config.source_root or config.source_repo_id else source.commit
    chosen = None if source.chosen is None or config.edited else list(source.chosen)
    options = DatasetOptions(
        config.source_repo_id or source.repo_id, config.source_root, config.source_revision or wanted, chosen
    )
    repo_id = config.output_repo_id or f"{name}_joined"
    target = dataset_root(repo_id, config.output_root)
    join_companion(labels, options.open(), target, repo_id, config.edited)
    return target


def main() -> None:
    """Entry point of the console script."""
    config = parse(JoinConfig)
    print(f"The segmented dataset is in {run(lambda: join(config))}.")
