"""Labels that a dataset brings along: a column of them, or the subtasks that people or ``lerobot-annotate`` wrote.

A subtask is in force from its timestamp until the next one begins, as LeRobot's ``active_at`` has it.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import LANGUAGE_COLUMNS, SUBTASKS, TRUE_STAGE, DatasetError, IntArray

from .checks import require_whole
from .collection import read_collection
from .dataset import AnyDataset, LocalDataset
from .tables import read_table

logger = logging.getLogger(__name__)

SUBTASK_STYLE = "subtask"
"""LeRobot's style of the language annotations that are subtasks."""

_FIELDS = {"role", "content", "style", "timestamp", "camera", "tool_calls"}

MOST_VALUES = 256
"""A column with more distinct values counts or measures something; it does not label."""


@dataclass(frozen=True)
class GivenLabels:
    """Labels that were there before, as skills.

    Attributes:
        labels: ``(T,)`` int64 label of every frame, in ``[0, len(names))``, per chosen demonstration.
        names: One name per label, all different.
    """

    labels: list[IntArray]
    names: tuple[str, ...]


def given_labels(dataset: AnyDataset, source: str) -> GivenLabels:
    """Reads the labels that a dataset brings along.

    Args:
        dataset: What stands for the dataset; its chosen episodes must be whole on this machine.
        source: `SUBTASKS`, one label per distinct text in the order of appearance; or the name of a column of integers
            or truths, one label per distinct value in ascending order.

    Raises:
        DatasetError: There are no such labels, or they label only a part of the demonstrations.
    """
    local = LocalDataset.of(dataset)
    return _of_subtasks(local) if source == SUBTASKS else _of_column(local, source)


def read_annotations(dataset: AnyDataset) -> list[list[dict[str, Any]]]:
    """Reads the persistent language annotations of every chosen episode; no rows where the dataset has none.

    Args:
        dataset: What stands for the dataset.

    Returns:
        Per episode its rows, with ``role``, ``content``, ``style``, ``timestamp`` (seconds), ``camera`` and
        ``tool_calls``.

    Raises:
        DatasetError: The dataset is damaged or incomplete, or the frames of an episode have different rows.
    """
    local, column = LocalDataset.of(dataset), LANGUAGE_COLUMNS[0]
    if column not in local.features:
        return [[] for _ in local.episodes]
    found: dict[int, list[dict[str, Any]]] = {}
    for shard in local.shards([column]):
        index, cells = shard["index"].to_numpy(), shard[column]
        if (np.diff(index) < 0).any():
            order = np.argsort(index, kind="stable")
            index, cells = index[order], cells.take(order)
        for episode in local.episodes:
            low, high = np.searchsorted(index, [episode["dataset_from_index"], episode["dataset_to_index"]])
            if low == high:
                continue
            number, cell = int(episode["episode_index"]), cells.slice(low, high - low)
            if not cell.slice(1).equals(cell.slice(0, len(cell) - 1)):
                raise DatasetError(
                    f"{local.root}: the frames of episode {number} have different {column!r}; LeRobot has the same "
                    "rows in all of them. Annotate the episode again."
                )
            found[number] = cell[0].as_py() or []
            if not all(isinstance(row, dict) and row.keys() >= _FIELDS for row in found[number]):
                raise DatasetError(f"{local.root}: {column!r} of episode {number} is not what LeRobot writes there.")
    return [found.get(int(episode["episode_index"]), []) for episode in local.episodes]


def _of_column(dataset: LocalDataset, name: str) -> GivenLabels:
    dataset.require([name], f"labels are a column, or {SUBTASKS!r}")
    table = read_table(dataset, [name])
    require_whole(table)
    column = table.columns[name]
    values, numbers = np.unique(column[table.rows], return_inverse=True)
    if column.ndim != 1 or column.dtype.kind not in "iub" or len(values) > MOST_VALUES:
        raise DatasetError(
            f"{dataset.root}: {name!r} does not label frames: {len(values)} distinct values of type {column.dtype}, "
            f"where a column of at most {MOST_VALUES} distinct integers or truths was expected."
        )
    lengths = table.ends - table.starts
    labels = np.split(numbers.astype(np.int64), np.cumsum(lengths)[:-1])
    return GivenLabels(labels, _value_names(dataset, name, values.tolist()))


def _value_names(dataset: LocalDataset, column: str, values: Sequence[int]) -> tuple[str, ...]:
    """Names values by what the recorder of the demonstrations calls them, where that is known."""
    stages = read_collection(dataset.root).get("stages") if column == TRUE_STAGE else None
    if isinstance(stages, list) and len(set(map(str, stages))) == len(stages) > max(values) and min(values) >= 0:
        return tuple(str(stages[value]) for value in values)
    return tuple(f"{column} {value}" for value in values)


def _of_subtasks(dataset: LocalDataset) -> GivenLabels:
    numbers = [int(episode["episode_index"]) for episode in dataset.episodes]
    subtasks = [[row for row in rows if row["style"] == SUBTASK_STYLE] for rows in read_annotations(dataset)]
    if bare := [number for number, rows in zip(numbers, subtasks, strict=True) if not rows]:
        raise DatasetError(
            f"{dataset.root}: {len(bare)} of {len(numbers)} episodes have no subtasks (the first is {bare[0]}). "
            "Annotate them (lerobot-annotate does), choose others with --episodes, or take labels from a column."
        )
    table = read_table(dataset, ["timestamp"])
    require_whole(table)
    known: dict[str, int] = {}
    labels, late, lost = [], 0, 0
    for number, rows, start, end in zip(numbers, subtasks, table.starts, table.ends, strict=True):
        where = f"{dataset.root}, episode {number}"
        starts, texts = _starts(rows, table.columns["timestamp"][start:end], where)
        late, starts[0] = max(late, int(starts[0])), 0
        lengths = np.diff([*starts.tolist(), int(end - start)])
        lost += int((lengths == 0).sum())
        found = [known.setdefault(text, len(known)) for text, length in zip(texts, lengths, strict=True) if length]
        labels.append(np.repeat(np.array(found, dtype=np.int64), lengths[lengths > 0]))
    if late:
        logger.warning("%s: frames before the first subtask, up to %d an episode, go to it.", dataset.root, late)
    if lost:
        logger.warning("%s: %d subtasks hold for no frame and are left out.", dataset.root, lost)
    return GivenLabels(labels, tuple(known))


def _starts(rows: Sequence[Mapping[str, Any]], times: NDArray[np.float32], where: str) -> tuple[IntArray, list[str]]:
    """Finds the first frame of every subtask of an episode, ``(S,)``, and its text; checks them."""
    for row in rows:
        if not isinstance(row["content"], str) or not row["content"].strip() or not isfinite(row["timestamp"]):
            raise DatasetError(
                f"{where}: the subtask {row['content']!r} at {row['timestamp']} s has no text or no time."
            )
    ordered = sorted(rows, key=lambda row: float(row["timestamp"]))
    # In single precision, as LeRobot reads them: a stored 0.7 would begin after the frame of 0.7 s.
    begins = np.array([row["timestamp"] for row in ordered], dtype=np.float32)
    if len(twice := np.flatnonzero(np.diff(begins) == 0)):
        texts = [ordered[int(twice[0]) + i]["content"] for i in range(2)]
        raise DatasetError(f"{where}: two subtasks begin at {begins[twice[0]]:g} s: {texts[0]!r} and {texts[1]!r}.")
    starts: IntArray = np.minimum(np.searchsorted(times, begins), len(times))
    return starts, [row["content"] for row in ordered]
