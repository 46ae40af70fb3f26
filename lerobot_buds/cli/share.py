"""``lerobot-buds-share``: sends a segmented dataset, its labels alone, a representation or a checkpoint to the Hub."""

from dataclasses import dataclass
from pathlib import Path

from lerobot_buds.core import SEGMENTATION_FILE, ConfigError

from .running import parse, run


@dataclass
class ShareConfig:
    """What to share; an interrupted command is run again, and sends what is missing."""

    root: Path
    """Folder of what is to be shared: a segmented dataset, a representation, or a checkpoint (``pretrained_model``)."""

    repo_id: str
    """Its repository on the Hub, created where missing."""

    private: bool | None = None
    """Whether a new repository is private; the account's own default where None."""

    branch: str | None = None
    """Where to put it in its repository, created where missing; the main branch where None."""

    labels_only: bool = False
    """Of a segmented dataset, shares no recordings: a companion, which lerobot-buds-join joins with the source."""

    output_root: Path | None = None
    """Folder to create for the companion; None for ``outputs/labels/`` and its name."""

    representation: bool = True
    """Whether a companion holds the representation too, by which others label demonstrations of theirs."""

    push_to_hub: bool = True
    """Whether a companion is sent; otherwise it is only written."""

    diagnosis: Path | None = None
    """Of a checkpoint, what ``lerobot-buds-diagnose --output`` wrote, for its card."""

    rollouts: Path | None = None
    """Of a checkpoint, the folder of ``lerobot-buds-rollout``, for its card."""


def share(config: ShareConfig) -> str:
    """Shares it.

    Returns:
        Address of the repository, or the folder of a companion that is not sent.

    Raises:
        ConfigError: There is nothing to share, or a setting does not go with it.
        BudsError: It is damaged, or the repository may not be written or cannot be reached.
    """
    from lerobot_buds.representation import REPRESENTATION_FILES, Representation
    from lerobot_buds.segmentation import share_dataset

    if not config.root.is_dir():
        raise ConfigError(f"{config.root} is no folder on this machine: there is nothing to share.")
    root, target = config.root, (config.repo_id, config.private, config.branch)
    is_dataset, is_policy = (root / SEGMENTATION_FILE).exists(), (root / "config.json").exists()
    if config.labels_only and not is_dataset:
        raise ConfigError(f"labels_only=true shares labels of a segmented dataset, which {root} is not.")
    if (config.diagnosis or config.rollouts) and not is_policy:
        raise ConfigError(f"diagnosis and rollouts are of a checkpoint, which {root} is not.")
    if config.labels_only:
        return _share_labels(config)
    if is_dataset:
        return share_dataset(root, *target)
    if all((root / name).exists() for name in REPRESENTATION_FILES):
        return Representation.load(root).push_to_hub(*target)
    if is_policy:
        from lerobot_buds.evaluation.share import share_checkpoint

        return share_checkpoint(root, *target, config.diagnosis, config.rollouts)
    raise ConfigError(f"{root} holds no segmented dataset, no representation and no checkpoint.")


def _share_labels(config: ShareConfig) -> str:
    from lerobot_buds.segmentation import share_labels, write_companion

    folder = config.output_root or Path("outputs/labels").absolute() / config.repo_id
    write_companion(config.root, folder, config.repo_id, config.representation)
    if not config.push_to_hub:
        return str(folder)
    return share_labels(folder, config.repo_id, config.private, config.branch)


def main() -> None:
    """Entry point of the console script."""
    config = parse(ShareConfig)
    print(f"Shared: {run(lambda: share(config))}")
