"""Column, file and feature names shared by every stage, and the rules that select state dimensions by name."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from math import isclose

from .errors import ConfigError, near_names

SKILL_ID = "skill_id"
"""int64 column: the skill of a frame, in ``[0, n_skills)``."""

SUBGOAL_INDEX = "subgoal_index"
"""int64 column: the absolute ``index`` of the frame that is this frame's subgoal."""

TRUE_STAGE = "true_stage"
"""int64 column of scripted demonstrations: the demonstrator's own stage. Scores segmentations, never trains."""

SUBTASKS = "subtasks"
"""In settings that say where labels come from: the subtasks among the dataset's language annotations, not a column."""

LANGUAGE_COLUMNS = ("language_persistent", "language_events")
"""LeRobot's columns of language annotations. Subtasks are rows of the first, repeated in all frames of an episode."""

STATE = "observation.state"
ACTION = "action"
IMAGE_PREFIX = "observation.images."
WORKSPACE_CAMERA = "observation.images.agentview"
EYE_IN_HAND_CAMERA = "observation.images.eye_in_hand"

OUR_STATE = (
    *(f"joint_{number}.pos" for number in range(1, 8)),
    *("gripper_left.pos", "gripper_right.pos", "eef_x.pos", "eef_y.pos", "eef_z.pos"),
)
"""Names of the state that our environments record. Whoever has exactly these gets what the paper's networks read."""

OUR_ACTION = ("delta_x.pos", "delta_y.pos", "delta_z.pos", "gripper.pos")
"""Names of the actions that our environments take, all in [-1, 1]: LeRobot's rollouts tell a robot only ``*.pos``."""

OUR_FORMER_ACTION = tuple(name.removesuffix(".pos") for name in OUR_ACTION)
"""The same in recordings of before there was a robot, and in what was learnt from them."""

RENDER_PROFILES = ("fast", "fastest", "full")
"""How our simulator can draw. Observations tell by a number, the place in this list, so it only ever grows."""

RECORD_DIR = "meta/buds"
"""Folder of this package's own records inside a dataset root; below ``meta/`` so that it travels to the Hub."""

SEGMENTATION_FILE = f"{RECORD_DIR}/segmentation.json"
EXEMPLARS_FILE = f"{RECORD_DIR}/exemplars.safetensors"
NAMES_FILE = f"{RECORD_DIR}/names.yaml"
COLLECTION_FILE = f"{RECORD_DIR}/collection.json"
CONTACT_SHEET_FILE = f"{RECORD_DIR}/contact_sheet.png"
TIMELINE_FILE = f"{RECORD_DIR}/timeline.png"

CARD_FILE = "README.md"
"""The card of a repository, as the Hub shows it."""


def select_dims(names: Sequence[str], patterns: Sequence[str]) -> list[int]:
    """Selects the dimensions of a vector whose names match any shell-style pattern.

    Args:
        names: One name per dimension, for example ``["joint_1.pos", "gripper_left.pos"]``.
        patterns: Patterns such as ``"gripper*"``, matched with case.

    Returns:
        The matching dimensions in ascending order; empty where nothing matches.
    """
    return [i for i, name in enumerate(names) if any(fnmatchcase(name, p) for p in patterns)]


def dims_used(
    setting: str,
    names: Sequence[str],
    patterns: Sequence[str] | None,
    ours: Sequence[str],
    others: Sequence[str] = ("*",),
) -> list[int]:
    """Selects the dimensions of a state that a network reads.

    What a robot calls its joints is nobody's to guess: a pattern that suits one robot matches a part of another's
    without a word. Hence patterns are the user's, or those of our own environments, which are told by all their names.

    Args:
        setting: Name of the user's setting, for messages.
        names: One name per dimension; their numbers where a dataset has no names.
        patterns: The user's; None where he asks for none in particular, empty where he wants no dimension.
        ours: Patterns for the state of our own environments, `OUR_STATE`.
        others: Patterns for any other robot; all dimensions by default.

    Returns:
        The dimensions in ascending order.

    Raises:
        ConfigError: A pattern of the user's matches no dimension; names them all.
    """
    if patterns is None:
        return select_dims(names, ours if tuple(names) == OUR_STATE else others)
    for pattern in patterns:
        if not select_dims(names, [pattern]):
            raise ConfigError(
                f"{setting}: {pattern!r} matches no dimension of the state. {near_names(pattern, names)} Leave "
                f"{setting} out to have it chosen."
            )
    return select_dims(names, patterns)


def same_rate(one: float, other: float) -> bool:
    """Compares two rates (per second): 30000/1001 is 29.97, and 30 is not."""
    return isclose(one, other, rel_tol=1e-4)


def frames_of_seconds(seconds: float, fps: float) -> int:
    """Converts a duration to whole frames, at least one.

    Args:
        seconds: The duration (seconds).
        fps: The frame rate (frames per second).
    """
    return max(1, round(seconds * fps))
