"""Column, file and feature names shared by every stage, and the rule that selects state dimensions by name."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from .errors import ConfigError

SKILL_ID = "skill_id"
"""int64 column: the skill of a frame, in ``[0, n_skills)``."""

SUBGOAL_INDEX = "subgoal_index"
"""int64 column: the absolute ``index`` of the frame that is this frame's subgoal."""

TRUE_STAGE = "true_stage"
"""int64 column of scripted demonstrations: the demonstrator's own stage. Scores segmentations, never trains."""

STATE = "observation.state"
ACTION = "action"
IMAGE_PREFIX = "observation.images."
WORKSPACE_CAMERA = "observation.images.agentview"
EYE_IN_HAND_CAMERA = "observation.images.eye_in_hand"

RENDER_PROFILES = ("fast", "fastest", "full")
"""How our simulator can draw. Observations tell by a number, the place in this list, so it only ever grows."""

RECORD_DIR = "meta/buds"
"""Folder of this package's own records inside a dataset root; below ``meta/`` so that it travels to the Hub."""

SEGMENTATION_FILE = f"{RECORD_DIR}/segmentation.json"
EXEMPLARS_FILE = f"{RECORD_DIR}/exemplars.safetensors"
COLLECTION_FILE = f"{RECORD_DIR}/collection.json"
CONTACT_SHEET_FILE = f"{RECORD_DIR}/contact_sheet.png"


def select_dims(names: Sequence[str], patterns: Sequence[str]) -> list[int]:
    """Selects the dimensions of a vector whose names match any shell-style pattern.

    Args:
        names: One name per dimension, for example ``["joint_1.pos", "gripper_left.pos"]``.
        patterns: Patterns such as ``"gripper*"``, matched with case.

    Returns:
        The matching dimensions in ascending order; empty where nothing matches.
    """
    return [i for i, name in enumerate(names) if any(fnmatchcase(name, p) for p in patterns)]


def dimensions_used(names: Sequence[str], patterns: Sequence[str] | None, setting: str) -> list[int]:
    """Settles which dimensions of a robot's vector are used: all of them, unless a user names some.

    No pattern is a default: one that fits our robot may match a part of somebody else's, in silence.

    Args:
        names: One name per dimension.
        patterns: Shell-style patterns; None for all dimensions, none of them where empty.
        setting: The setting that holds the patterns, for the message.

    Returns:
        Dimensions in ascending order.

    Raises:
        ConfigError: A pattern matches nothing.
    """
    if patterns is None:
        return list(range(len(names)))
    idle = [pattern for pattern in patterns if not select_dims(names, [pattern])]
    if idle:
        raise ConfigError(
            f"{setting}: {idle} match none of the dimensions {list(names)}. Name others, or leave it out."
        )
    return select_dims(names, patterns)


def frames_of_seconds(seconds: float, fps: float) -> int:
    """Converts a duration to whole frames, at least one.

    Args:
        seconds: The duration (seconds).
        fps: The frame rate (frames per second).
    """
    return max(1, round(seconds * fps))
