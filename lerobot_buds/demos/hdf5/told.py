"""What a file says about its demonstrations itself: their rate, their task, the words of the task."""

import json
import math
from dataclasses import dataclass, field
from typing import Any

import h5py

from lerobot_buds.core import DatasetError

from .source import Source


@dataclass(frozen=True)
class Told:
    """What a file says.

    Attributes:
        fps: Control steps per second, where it says so.
        environment: Name of the simulated task, where it says so.
        instructions: What a demonstration does, in words, by its name, as far as it says so.
    """

    fps: float | None = None
    environment: str | None = None
    instructions: dict[str, str] = field(default_factory=dict)


def told_by(data: h5py.Group, names: list[str], source: Source) -> Told:
    """Reads what robosuite, robomimic, LIBERO and RoboCasa write into attributes.

    Args:
        data: The group of all demonstrations.
        names: Names of those to read.
        source: Where they are from, for messages.

    Raises:
        DatasetError: An attribute is damaged, or the rate is no rate.
    """
    env_args, env_info = (_json(data, name, source) for name in ("env_args", "env_info"))
    settings = env_args.get("env_kwargs")
    rate = (settings if isinstance(settings, dict) else {}).get("control_freq", env_info.get("control_freq"))
    known = (data.attrs.get("env_name"), env_args.get("env_name"), env_info.get("env_name"), data.attrs.get("env"))
    environment = next((str(name) for name in known if name), None)
    instruction = _words(_json(data, "problem_info", source).get("language_instruction"))
    instructions = {}
    for name in names:
        words = _words(_json(data[name], "ep_meta", source).get("lang")) or instruction
        if words:
            instructions[name] = words
    return Told(None if rate is None else _rate(rate, source), environment, instructions)


def _json(group: h5py.Group, name: str, source: Source) -> dict[str, Any]:
    text = group.attrs.get(name)
    if text is None:
        return {}
    try:
        content = json.loads(text)
    except (TypeError, ValueError) as error:
        raise DatasetError(
            f"{source.path}: attribute {name!r} of {group.name} is no JSON ({error}); fetch the file "
            "again, or repair it."
        ) from error
    return content if isinstance(content, dict) else {}


def _words(value: Any) -> str:
    """Takes an instruction as text; LIBERO keeps some as a list of words, which BDDL files write so."""
    return " ".join(map(str, value)) if isinstance(value, list) else str(value or "").strip().strip('"')


def _rate(value: Any, source: Source) -> float:
    try:
        rate = float(value)
    except (TypeError, ValueError):
        rate = math.nan
    if not 0 < rate < math.inf:
        raise DatasetError(f"{source.path}: control_freq={value!r} is no rate; repair the file's attributes.")
    return rate
