"""What every command shares: its settings, where datasets live, and how an error is shown."""

import logging
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import draccus
from draccus.utils import ParsingError
from yaml import YAMLError

from lerobot_buds.core import BudsError

from .texts import keep_texts, require_texts


def parse[T](settings: type[T], given: Sequence[str] | None = None) -> T:
    """Reads a command's settings from its arguments; where they cannot work, ends the program with the reason.

    Text stays the text that was typed, and paths are absolute from here on: libraries that take a path as text see a
    URL in a relative ``run-10:30``.

    Args:
        settings: Dataclass of the settings.
        given: The arguments; those of the program where None.
    """
    try:
        arguments = keep_texts(settings, sys.argv[1:] if given is None else given)
        require_texts(settings, arguments)
        config: T = draccus.parse(settings, args=arguments)
    except ParsingError as error:
        # draccus says only which class refused, not why.
        raise SystemExit(f"error: {error.__cause__ if isinstance(error.__cause__, BudsError) else error}") from error
    except (BudsError, OSError, YAMLError) as error:
        raise SystemExit(f"error: {error}") from error
    _resolve_paths(config)
    return config


def run[T](command: Callable[[], T]) -> T:
    """Runs a command's work; an expected error ends the program with its message alone and status 1."""
    logging.basicConfig(format="%(levelname)s %(message)s")
    logging.getLogger("lerobot_buds").setLevel(logging.INFO)  # not the requests of every library below
    try:
        return command()
    except BudsError as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("interrupted; run the same command again to go on")


def dataset_root(repo_id: str, root: str | Path | None) -> Path:
    """Tells where a dataset lives: the folder given, or LeRobot's own place for its name; absolute."""
    if root is not None:
        return Path(root).absolute()
    from lerobot.utils.constants import HF_LEROBOT_HOME

    return Path(HF_LEROBOT_HOME).absolute() / repo_id


def _resolve_paths(config: Any) -> None:
    """Makes every path among settings absolute; frozen ones, which libraries share, hold none."""
    for field in fields(config):
        value = getattr(config, field.name)
        if isinstance(value, Path):
            setattr(config, field.name, value.absolute())
        elif is_dataclass(value):
            _resolve_paths(value)
