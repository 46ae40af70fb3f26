"""Writes the segments of a segmented dataset as LeRobot's subtasks, for its visualizer, recipes and policies.

Invariants: every frame of an episode has the same rows; annotations of other styles stay; the label columns, images and
everything else are as they were; the files are written first and then renamed together.
"""

import json
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lerobot_buds.core import (
    LANGUAGE_COLUMNS,
    NAMES_FILE,
    IntArray,
    SegmentationError,
    read_json,
    remove_leftovers,
    replaced_together,
)

from .naming import LONGEST_NAME, write_names
from .record import SegmentationRecord, load_labels

if TYPE_CHECKING:
    import pyarrow as pa

    from lerobot_buds.data import FrameTable, LocalDataset

logger = logging.getLogger(__name__)

Annotation = dict[str, Any]
"""A row of `LANGUAGE_COLUMNS`, as LeRobot has it."""


def write_subtasks(root: Path, names: Sequence[str], replace: bool = False) -> None:
    """Writes the segments of a segmented dataset into it as subtasks, in place, and the names into its file of names.

    Args:
        root: Folder of the dataset, which must be whole.
        names: One name per skill.
        replace: Replaces subtasks that are not of these segments, those of people for example.

    Raises:
        SegmentationError: Labels and dataset are out of step, a name is too long, or there are subtasks of others.
        DatasetError: The dataset is damaged or incomplete, or another process is writing it.
        StorageError: It cannot be written; it is as it was.
    """
    from lerobot_buds.data import LocalDataset, only_writer, read_annotations, read_table, require_whole

    if too_long := [number for number, name in enumerate(names) if len(name) > LONGEST_NAME]:
        raise SegmentationError(
            f"The name of skill {too_long[0]} has {len(names[too_long[0]])} characters, more than {LONGEST_NAME}: "
            "names are repeated in every frame. Shorten it."
        )
    dataset = LocalDataset(root)
    with only_writer(dataset.root):
        record, _, _ = load_labels(dataset.root)
        table = read_table(dataset, ["timestamp"])
        require_whole(table)
        annotations = _annotations(record, names, table, read_annotations(dataset), replace)
        _rewrite(dataset, table, annotations, names)
    logger.info("Wrote %d skills as subtasks into %s.", record.n_skills, dataset.root)


def _annotations(
    record: SegmentationRecord,
    names: Sequence[str],
    table: "FrameTable",
    before: Sequence[Sequence[Annotation]],
    replace: bool,
) -> list[list[Annotation]]:
    """Makes the rows of every episode, in the order of LeRobot's own writer."""
    from lerobot_buds.data import SUBTASK_STYLE

    times, made = table.columns["timestamp"], []
    for number, (episode, rows) in enumerate(zip(record.episodes, before, strict=True)):
        # The frames' own times, bit for bit: LeRobot looks for the last row that is not later than the frame.
        starts = [float(times[table.starts[number] + segment.start]) for segment in episode.segments]
        theirs = [float(np.float32(row["timestamp"])) for row in rows if row["style"] == SUBTASK_STYLE]
        if theirs and sorted(theirs) != starts and not replace:
            raise SegmentationError(
                f"{table.root}: episode {number} has {len(theirs)} subtasks that are not those of its {len(starts)} "
                "segments: people's, or of another segmentation. --replace=true puts the segments in their place; "
                "lerobot-buds-segment --labels_from=subtasks makes skills of them instead."
            )
        ours: list[Annotation] = [
            {
                "role": "assistant",
                "content": names[segment.label],
                "style": SUBTASK_STYLE,
                "timestamp": start,
                "camera": None,
                "tool_calls": None,
            }
            for segment, start in zip(episode.segments, starts, strict=True)
        ]
        kept = [row for row in rows if row["style"] != SUBTASK_STYLE]
        made.append(sorted(ours + kept, key=lambda row: (row["timestamp"], row["style"] or "", row["role"] or "")))
    return made


def _rewrite(
    dataset: "LocalDataset", table: "FrameTable", annotations: Sequence[Sequence[Annotation]], names: Sequence[str]
) -> None:
    import pyarrow.parquet as pq
    from lerobot.datasets.io_utils import write_table_one_row_group_per_episode

    info = read_json(dataset.root / "meta/info.json")
    for column in LANGUAGE_COLUMNS:
        info["features"].setdefault(column, {"dtype": "language", "shape": [1], "names": None})
    with replaced_together() as part_of:
        for path in dict.fromkeys(dataset.data_path(record) for record in dataset.episodes):
            remove_leftovers(path.parent, path.name)
            annotated = _annotated(pq.read_table(path), table, annotations, info["features"])
            write_table_one_row_group_per_episode(annotated, part_of(path))
        part_of(dataset.root / "meta/info.json").write_text(json.dumps(info, indent=4, ensure_ascii=False), "utf-8")
        write_names(part_of(dataset.root / NAMES_FILE), names)


def _annotated(
    rows: "pa.Table", table: "FrameTable", annotations: Sequence[Sequence[Annotation]], features: dict[str, Any]
) -> "pa.Table":
    """Puts the annotations of their episodes into the rows of a data file, in LeRobot's own types."""
    import pyarrow as pa
    from datasets.table import table_cast
    from lerobot.datasets.feature_utils import get_hf_features_from_features

    persistent, events = LANGUAGE_COLUMNS
    episodes = np.searchsorted(table.ends, rows["index"].to_numpy(), side="right")
    if persistent in rows.column_names:
        rows = rows.drop_columns([persistent])
    rows = rows.append_column(persistent, pa.chunked_array(list(_cells(episodes, annotations))))
    if events not in rows.column_names:
        rows = rows.append_column(events, pa.array([[]] * len(rows)))
    shaped = {name: {**feature, "shape": tuple(feature["shape"])} for name, feature in features.items()}
    schema = get_hf_features_from_features(shaped).arrow_schema
    return table_cast(rows.select(schema.names), schema)


def _cells(episodes: IntArray, annotations: Sequence[Sequence[Annotation]]) -> "Iterator[pa.Array]":
    """Repeats annotations for the rows of their episodes, whose numbers are ``(N,)``: a chunk an episode."""
    import pyarrow as pa

    kinds = pa.array([list(rows) for rows in annotations])  # pyarrow cannot make an array of LeRobot's own type
    for run in np.split(episodes, np.flatnonzero(np.diff(episodes)) + 1):
        yield kinds.slice(int(run[0]), 1).take(pa.array(np.zeros(len(run), dtype=np.int64)))
