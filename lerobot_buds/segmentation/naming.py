"""Names of skills: automatic ones at first, kept in one YAML file of the segmented dataset that people edit."""

from collections import Counter
from collections.abc import Hashable, Sequence
from pathlib import Path
from reprlib import Repr
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from lerobot_buds.core import (
    NAMES_FILE,
    STATE,
    FloatArray,
    SegmentationError,
    refuse_newer,
    write_atomically,
)

from .record import SegmentationRecord

if TYPE_CHECKING:
    from lerobot_buds.data import LocalDataset

NAMES_VERSION = 1
"""Raised whenever the meaning of the file changes; newer ones are refused."""

LONGEST_NAME = 200
"""Characters; LeRobot repeats the names of an episode in all of its frames."""

_GRIPPERS = ("gripper", "finger", "jaw")
"""A dimension of the state whose name has one of these is a gripper's opening, whatever its unit (ours)."""

_CLEAR = 0.3
"""Share of its range by which a gripper opens or closes, else it stays (ours)."""

_SHOWN = 10

_short = Repr(maxlevel=1).repr  # the file may be anybody's, with texts of any length and lists of lists of lists

_HEADER = """\
# Names of the skills of this dataset, one line each, all different. Edit them, then write them into the dataset:
#   lerobot-buds-name --root=FOLDER_OF_THE_DATASET
"""


def automatic_names(record: SegmentationRecord, dataset: "LocalDataset", known: Sequence[str] = ()) -> tuple[str, ...]:
    """Names skills by what is known of them, for example ``"skill 2: 3.1 s, gripper closes"``.

    Args:
        record: The segmentation.
        dataset: The dataset that it is of; its chosen episodes are those of the record.
        known: Names of the first skills, from the library that they are of; those that people gave are kept.

    Raises:
        DatasetError: The dataset is damaged.
    """
    changes = _gripper_changes(record, dataset)
    names: list[str] = []
    for number, (skill, change) in enumerate(zip(record.skills, changes, strict=True)):
        gripper = ", gripper closes" if change <= -_CLEAR else ", gripper opens" if change >= _CLEAR else ""
        seen = f"{skill['mean_seconds']:.1f} s" if skill["segments"] else "does not occur here"
        names.append(f"skill {number}: {seen}{gripper}")
    for number, name in enumerate(known):
        if not name.startswith(f"skill {number}: "):
            names[number] = name
    return tuple(names)


def _gripper_changes(record: SegmentationRecord, dataset: "LocalDataset") -> FloatArray:
    """Measures by how much of its range a gripper opens in the median segment of every skill, ``(K,)``; 0 unknown."""
    from lerobot_buds.data import dimension_names, read_table

    changes = np.zeros(record.n_skills)
    feature = dataset.features.get(STATE, {"shape": ()})
    names = dimension_names(feature) if len(feature["shape"]) == 1 else []
    dims = [d for d, name in enumerate(names) if any(part in name.lower() for part in _GRIPPERS)]
    if not dims:
        return changes
    table = read_table(dataset, [STATE])
    # The fingers of one gripper may move in opposite directions: sizes, not signs, say how far it is open.
    opening = np.abs(table.columns[STATE].reshape(len(table.present), -1)[:, dims].astype(np.float64)).mean(axis=1)
    reach = np.ptp(opening[table.rows])
    if not reach > 0:
        return changes
    found: list[list[float]] = [[] for _ in changes]
    for episode, first, end in zip(record.episodes, table.starts, table.ends, strict=True):
        for segment in episode.segments:
            last = min(first + segment.end, end - 1)
            found[segment.label].append((opening[last] - opening[first + segment.start]) / reach)
    return np.array([np.median(of_skill) if of_skill else 0.0 for of_skill in found])


def write_names(path: Path, names: Sequence[str]) -> None:
    """Writes a file of names, atomically; any text comes back from `read_names` exactly.

    Args:
        path: The file.
        names: One name per skill.

    Raises:
        StorageError: The file cannot be written.
    """
    # Each in double quotes: the only style in which PyYAML reads all that it has written, U+2028 for example.
    quoted = [yaml.safe_dump(name, default_style='"', allow_unicode=True, width=float("inf")) for name in names]
    lines = [f"version: {NAMES_VERSION}\nskills:\n", *(f"  {number}: {name}" for number, name in enumerate(quoted))]
    write_atomically(path, lambda part: part.write_bytes((_HEADER + "".join(lines)).encode()))


def read_names(path: Path, n_skills: int) -> tuple[str, ...]:
    """Reads a file of names.

    Args:
        path: The file.
        n_skills: Number of skills K that must be named.

    Raises:
        SegmentationError: The file is no such file, or does not give each skill a name of its own; says all that is
            wrong with it.
    """
    try:
        content = yaml.load(path.read_bytes().decode("utf-8-sig"), _NoDuplicates)
    except FileNotFoundError as error:
        raise SegmentationError(f"{path} does not exist; lerobot-buds-name makes one.") from error
    except (OSError, yaml.YAMLError, ValueError, RecursionError) as error:
        raise SegmentationError(f"{path} cannot be read as YAML ({' '.join(str(error).split())}).") from error
    skills = content.get("skills") if isinstance(content, dict) else None
    if not isinstance(skills, dict):
        raise SegmentationError(f"{path} holds no names: it needs 'skills:' with lines such as '0: open the drawer'.")
    refuse_newer(path, content.get("version"), NAMES_VERSION, "the version that wrote it", SegmentationError)
    if wrong := _faults(skills, n_skills):
        more = f"; and {len(wrong) - _SHOWN} more faults" if len(wrong) > _SHOWN else ""
        raise SegmentationError(f"{path}: {'; '.join(wrong[:_SHOWN])}{more}.")
    return tuple(skills[number] for number in range(n_skills))


def _faults(skills: dict[Any, Any], n_skills: int) -> list[str]:
    known = f"the dataset has 0 to {n_skills - 1}"
    unknown = [key for key in skills if isinstance(key, bool) or key not in range(n_skills)]
    faults = [f"there is no skill {_short(key)} ({known})" for key in unknown]
    faults += [f"skill {number} has no name ({known})" for number in range(n_skills) if number not in skills]
    seen: dict[str, Any] = {}
    for key, name in skills.items():
        if not isinstance(name, str):
            faults.append(
                f'the name of skill {_short(key)} is read as {_short(name)}, no text: put it in quotes ("...")'
            )
        elif not name.strip():
            faults.append(f"the name of skill {_short(key)} is empty")
        elif any(0xD800 <= ord(letter) <= 0xDFFF for letter in name):
            faults.append(f"the name of skill {_short(key)} has half of a surrogate pair, which is no text")
        elif name in seen:
            faults.append(f"skills {seen[name]} and {_short(key)} are both named {_short(name)}")
        else:
            seen[name] = key
    return faults


def names_of(root: Path, n_skills: int) -> tuple[str, ...] | None:
    """Reads the names that a segmented dataset carries; None where it has none (segmented by an earlier version)."""
    path = root / NAMES_FILE
    return read_names(path, n_skills) if path.exists() else None


class _NoDuplicates(yaml.SafeLoader):  # type: ignore[misc]
    """Refuses a key that stands twice, of which YAML keeps the last in silence."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        keys = (self.construct_object(key, deep=True) for key, _ in node.value)
        counts = Counter(key for key in keys if isinstance(key, Hashable))
        if twice := [key for key, count in counts.items() if count > 1]:
            raise yaml.constructor.ConstructorError(None, None, f"{_short(twice[0])} stands twice", node.start_mark)
        mapping: dict[Hashable, Any] = super().construct_mapping(node, deep)
        return mapping
