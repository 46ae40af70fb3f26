"""Shares a checkpoint of policy ``buds``, with its diagnosis and its rollouts on the card."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from lerobot_buds.core import CARD_FILE, CheckpointError, read_json
from lerobot_buds.data import upload

from .checkpoint import checkpoint_folder, read_config
from .insight import figures_of
from .trace import RolloutRecord

DIAGNOSIS_FILE, RIBBONS_FILE = "buds/diagnosis.json", "buds/ribbons.png"
"""Where a checkpoint's repository holds them."""

_KINDS = ("*.json", "*.safetensors", "*.yaml")


def share_checkpoint(
    folder: Path,
    repo_id: str,
    private: bool | None = None,
    branch: str | None = None,
    diagnosis: Path | None = None,
    rollouts: Path | None = None,
) -> str:
    """Sends a checkpoint to the Hub.

    Args:
        folder: The checkpoint, ``pretrained_model``.
        repo_id: Its repository, created where missing.
        private: Whether a new repository is private; None for the account's own default.
        branch: Where to put it, created where missing; the main branch where None.
        diagnosis: What ``lerobot-buds-diagnose --output`` wrote.
        rollouts: Folder of ``lerobot-buds-rollout``.

    Returns:
        Address of the repository.

    Raises:
        CheckpointError: There is no such checkpoint, or the repository may not be written or cannot be reached.
        DatasetError: The record of rollouts is damaged.
    """
    from lerobot_buds.policy.card import card_text, write_card

    config = read_config(checkpoint_folder(str(folder)), None)
    files = {path.name: path for kind in _KINDS for path in sorted(folder.glob(kind))}
    if diagnosis is not None:
        files[DIAGNOSIS_FILE] = diagnosis
    ribbons = None if rollouts is None else rollouts / "ribbons.png"
    if ribbons is not None and ribbons.exists():
        files[RIBBONS_FILE] = ribbons
    text = card_text(
        config,
        repo_id,
        None if diagnosis is None else _figures(diagnosis),
        None if rollouts is None else _summary(rollouts),
        RIBBONS_FILE if RIBBONS_FILE in files else None,
    )
    with TemporaryDirectory() as place:
        write_card(Path(place), text, config.license, config.tags or ())
        files[CARD_FILE] = Path(place) / CARD_FILE
        return upload(files, repo_id, "Upload a policy", private=private, branch=branch)


def _figures(path: Path) -> dict[str, Any]:
    try:
        figures = read_json(path)
        _ = figures["frames"], dict(figures["errors"])
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise CheckpointError(
            f"{path} holds no diagnosis ({type(error).__name__}: {error}): lerobot-buds-diagnose --output writes one."
        ) from error
    assert isinstance(figures, dict)
    return figures


def _summary(folder: Path) -> dict[str, Any]:
    record = RolloutRecord.read(folder)
    return {"task": record.task, "figures": figures_of(record)}
