"""Sends a segmented dataset to the Hub: whole, or its labels alone."""

from pathlib import Path

from .card import card_kwargs, write_card
from .record import load_labels


def share_dataset(root: Path, repo_id: str, private: bool | None = None, branch: str | None = None) -> str:
    """Sends a segmented dataset to the Hub, as it is, with a card in LeRobot's.

    Args:
        root: Its folder; its card is brought up to date.
        repo_id: Its repository, created where missing.
        private: Whether a new repository is private; None for the account's own default.
        branch: Where to put it, created where missing; the main branch, with LeRobot's version tag, where None.

    Returns:
        Address of the repository.

    Raises:
        SegmentationError: The dataset is not segmented, or its labels are out of step with it.
        DatasetError: The repository may not be written, or cannot be reached.
    """
    from lerobot_buds.data import upload_dataset

    load_labels(root)
    write_card(root, repo_id)
    return upload_dataset(root, repo_id, private, branch, **card_kwargs(root, repo_id))


def share_labels(root: Path, repo_id: str, private: bool | None = None, branch: str | None = None) -> str:
    """Sends a companion to the Hub.

    Args:
        root: Folder of the companion.
        repo_id: Its repository, created where missing.
        private: Whether a new repository is private; None for the account's own default.
        branch: Where to put it, created where missing; the main branch where None.

    Raises:
        CheckpointError: The repository may not be written, or cannot be reached.
    """
    from lerobot_buds.data import upload

    files = {str(path.relative_to(root)): path for path in sorted(root.rglob("*")) if path.is_file()}
    return upload(files, repo_id, "Upload labels", private=private, branch=branch, repo_type="dataset")
