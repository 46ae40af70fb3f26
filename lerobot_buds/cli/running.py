"""What every command shares: its settings, where datasets live, and how an error is shown."""

import logging
import sys
from collections.abc import Callable
from pathlib import Path

import draccus
from draccus.utils import ParsingError

from lerobot_buds.core import BudsError


def parse[T](settings: type[T]) -> T:
    """Reads a command's settings from its arguments; where they cannot work, ends the program with the reason."""
    try:
        config: T = draccus.parse(settings)
    except ParsingError as error:
        # draccus says only which class refused, not why.
        raise SystemExit(f"error: {error.__cause__ if isinstance(error.__cause__, BudsError) else error}") from error
    return config


def run[T](command: Callable[[], T]) -> T:
    """Runs a command's work; an expected error ends the program with its message alone and status 1."""
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
    try:
        return command()
    except BudsError as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("interrupted; run the same command again to go on")


def dataset_root(repo_id: str, root: str | None) -> Path:
    """Tells where a dataset lives: the folder given, or LeRobot's own place for its name."""
    if root is not None:
        return Path(root)
    from lerobot.utils.constants import HF_LEROBOT_HOME

    return Path(HF_LEROBOT_HOME) / repo_id
