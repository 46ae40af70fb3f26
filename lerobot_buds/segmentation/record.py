"""The record of a segmentation: what was found, from what, with which settings; kept in the dataset's ``meta/buds``.

The record travels to the Hub with the dataset. It also guards the two label columns: LeRobot's edit tools renumber
frames and episodes and copy the columns as they are, so labels are only used if they still hash to what the record
says.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import (
    DISTRIBUTION,
    SEGMENTATION_FILE,
    SKILL_ID,
    SUBGOAL_INDEX,
    IntArray,
    Segment,
    SegmentationError,
    labels_of,
    lengths_by_label,
    read_json,
    refuse_newer,
    segments_of,
    sha256_of_json,
    subgoals_of,
    write_json,
)

SCHEMA_VERSION = 1
"""Raised whenever the record's meaning changes; older records are read, newer ones refused."""


def relabelling(place: Path | str, columns: Sequence[str] = (SKILL_ID, SUBGOAL_INDEX)) -> str:
    """Says how a dataset with labels that are of no use is segmented as it is now: advice for the end of a message.

    Args:
        place: Its folder.
        columns: The label columns that it has.
    """
    return (
        f"To segment it as it is now, take the labels out (lerobot-edit-dataset --repo_id=local/labelled "
        f"--root={place} --new_repo_id=local/unlabelled --operation.type=remove_feature "
        f"--operation.feature_names='[{', '.join(columns)}]'), then run lerobot-buds-segment "
        "--repo_id=local/unlabelled."
    )


@dataclass(frozen=True)
class SourceDescription:
    """The dataset that was segmented.

    Attributes:
        repo_id: Its name on the Hub, or its local name.
        fps: Frame rate (frames per second).
        episode_lengths: Frames of every episode.
        commit: The commit that it was fetched from; None where it was not fetched.
        chosen: Its episodes that were segmented, by number; None for all.
        content: Hash of every episode's rows, see `data.content_hashes`; empty in records of earlier versions.
    """

    repo_id: str
    fps: float
    episode_lengths: tuple[int, ...]
    commit: str | None = None
    chosen: tuple[int, ...] | None = None
    content: tuple[str, ...] = ()

    @classmethod
    def of_json(cls, content: dict[str, Any]) -> Self:
        """Reads what the record says of the source.

        Raises:
            KeyError: Something is missing.
            TypeError: Something is of another type.
            ValueError: The hashes are not one an episode.
        """
        chosen, hashes = content.get("chosen"), tuple(content.get("content", ()))
        lengths = tuple(content["episode_lengths"])
        if hashes and len(hashes) != len(lengths):
            raise ValueError("the source has another number of hashes than of episodes")
        numbers = None if chosen is None else tuple(chosen)
        return cls(content["repo_id"], content["fps"], lengths, content.get("commit"), numbers, hashes)

    @property
    def total_frames(self) -> int:
        """Number of frames of all episodes."""
        return sum(self.episode_lengths)


@dataclass(frozen=True)
class EpisodeLabels:
    """The labels of one episode.

    Attributes:
        segments: Half-open segments that tile the episode.
        sha256: Hash of the label columns, see `label_hash`.
    """

    segments: tuple[Segment, ...]
    sha256: str


@dataclass(frozen=True)
class SegmentationRecord:
    """Everything that is known about one segmentation. Plain data: the same inputs give the same bytes.

    Attributes:
        source: The dataset that was segmented.
        n_skills: Number of skills K.
        horizon: Subgoal horizon H (frames).
        episodes: Labels of every episode.
        parameters: Settings of skill discovery, with the durations that were taken from the demonstrations.
        seeds: Seed of every random stage.
        representation: Description of the latents, with a hash of the weights or settings that made them.
        agreement: Scores against true stages, where these are known.
        labels_from: Where the labels come from that were there before, see `given_labels`; None for discovered ones.
        library: The segmented dataset whose skills were taken over, where there is one, whether others were added,
            and its `lineage`.
        silhouettes: Where the number of skills was chosen, how well each number parts the segments.
        stability: How much of the labels holds when the demonstrations differ slightly; None where that is not known.
        schema_version: Version of the record's format.
        package_version: Version of this package that wrote it.
    """

    source: SourceDescription
    n_skills: int
    horizon: int
    episodes: tuple[EpisodeLabels, ...]
    parameters: dict[str, Any] = field(default_factory=dict)
    seeds: dict[str, int] = field(default_factory=dict)
    representation: dict[str, Any] = field(default_factory=dict)
    agreement: dict[str, float] | None = None
    labels_from: str | None = None
    library: dict[str, Any] | None = None
    silhouettes: dict[str, float] | None = None
    stability: float | None = None
    schema_version: int = SCHEMA_VERSION
    package_version: str = field(default_factory=lambda: version(DISTRIBUTION))

    @classmethod
    def of_labels(
        cls,
        labels: Sequence[IntArray],
        *,
        repo_id: str,
        fps: float,
        horizon: int,
        n_skills: int | None = None,
        commit: str | None = None,
        chosen: Sequence[int] | None = None,
        content: Sequence[str] = (),
        **description: Any,
    ) -> Self:
        """Makes the record of new labels.

        Args:
            labels: ``(T,)`` skill of every frame, per episode, out of ``0 .. K-1``.
            repo_id: Name of the segmented dataset's source.
            fps: Frame rate (frames per second).
            horizon: Subgoal horizon H (frames), at least 1.
            n_skills: Number of skills K, if some may not occur; as many as the labels have where None.
            commit: Commit of the source, see `SourceDescription`.
            chosen: Its episodes that were segmented, by number.
            content: Hash of every one's rows.
            **description: Any of the attributes from `parameters` to `stability`; plain data.
        """
        return cls(
            source=SourceDescription(
                repo_id,
                fps,
                tuple(len(episode) for episode in labels),
                commit,
                None if chosen is None else tuple(chosen),
                tuple(content),
            ),
            n_skills=n_skills or 1 + max(int(episode.max()) for episode in labels if len(episode)),
            horizon=horizon,
            episodes=tuple(
                EpisodeLabels(tuple(segments_of(e)), label_hash(e, subgoals_of(e, horizon) - np.arange(len(e))))
                for e in labels
            ),
            **description,
        )

    @property
    def labels(self) -> list[IntArray]:
        """The skill of every frame: one ``(T,)`` int64 array per episode."""
        return [labels_of(list(episode.segments)) for episode in self.episodes]

    @property
    def labels_hash(self) -> str:
        """Hash of all labels; a policy keeps it (`BudsConfig.segmentation`), to know the skills it was trained on."""
        return sha256_of_json([episode.sha256 for episode in self.episodes])

    @property
    def lineage(self) -> tuple[str, ...]:
        """The `labels_hash` of this segmentation and of those whose skills it took over, one after the other."""
        return (self.labels_hash, *(self.library or {}).get("lineage", ()))

    @property
    def skills(self) -> list[dict[str, float]]:
        """Per skill, the number of its segments and their mean length (frames, seconds)."""
        known = lengths_by_label(episode.segments for episode in self.episodes)
        lengths = [known.get(skill, []) for skill in range(self.n_skills)]
        means = [float(np.mean(skill)) if skill else 0.0 for skill in lengths]
        return [
            {"segments": len(skill), "mean_frames": round(mean, 3), "mean_seconds": round(mean / self.source.fps, 4)}
            for skill, mean in zip(lengths, means, strict=True)
        ]

    def write(self, root: Path) -> None:
        """Writes the record into a dataset, atomically.

        Args:
            root: Folder of the dataset.
        """
        content = asdict(self)
        content["source"]["total_frames"] = self.source.total_frames
        content["horizon_seconds"] = self.horizon / self.source.fps
        content["skills"] = self.skills
        write_json(root / SEGMENTATION_FILE, content)

    @classmethod
    def read(cls, root: Path) -> Self:
        """Reads the record of a dataset.

        Args:
            root: Folder of the dataset.

        Raises:
            SegmentationError: The folder or the record is missing, or the record is damaged, or of a newer version than
                this package knows.
        """
        if not root.is_dir():
            raise SegmentationError(f"{root} is no folder on this machine: there is no segmented dataset.")
        path = root / SEGMENTATION_FILE
        try:
            content = read_json(path)
        except FileNotFoundError as error:
            raise SegmentationError(
                f"{root} has no segmentation record ({SEGMENTATION_FILE}). If it was never segmented, run "
                "lerobot-buds-segment on it. If it was edited afterwards, lerobot-edit-dataset dropped the record, "
                f"because the labels no longer fit. {relabelling(root)}"
            ) from error
        except ValueError as error:
            raise SegmentationError(f"{path} is damaged ({error}). {relabelling(root)}") from error
        try:
            refuse_newer(
                path, content["schema_version"], SCHEMA_VERSION, content.get("package_version"), SegmentationError
            )
            return cls._of_json(content)
        except (KeyError, TypeError, ValueError) as error:
            raise SegmentationError(
                f"{path} is damaged ({type(error).__name__}: {error}). {relabelling(root)}"
            ) from error

    @classmethod
    def _of_json(cls, content: dict[str, Any]) -> Self:
        # Fields that an older version did not write keep their defaults; what is derived is not read back.
        known = {f.name: content[f.name] for f in fields(cls) if f.name in content}
        known["source"] = SourceDescription.of_json(content["source"])
        known["episodes"] = tuple(
            EpisodeLabels(tuple(Segment(*segment) for segment in episode["segments"]), episode["sha256"])
            for episode in content["episodes"]
        )
        record = cls(**known)
        if [len(episode) for episode in record.labels] != list(record.source.episode_lengths):
            raise ValueError("segments do not tile the episodes")
        return record


def label_hash(skill_id: IntArray, offset: IntArray) -> str:
    """Hashes the labels of one episode by what survives a renumbering of frames.

    Args:
        skill_id: ``(T,)`` skills.
        offset: ``(T,)`` frames from a frame to its subgoal: ``subgoal_index - index``.
    """
    digest = sha256()
    for column in (skill_id, offset):
        digest.update(np.ascontiguousarray(column, dtype="<i8").tobytes())
    return digest.hexdigest()


def check_labels(
    record: SegmentationRecord,
    skill_id: IntArray,
    subgoal_index: IntArray,
    starts: IntArray,
    ends: IntArray,
    present: NDArray[np.bool_],
    place: Path | str = "FOLDER",
) -> None:
    """Refuses labels that are not those of the record, as after deleting, merging or reordering episodes.

    Args:
        record: The dataset's segmentation record.
        skill_id: ``(N,)`` skill of every frame, in the order of the absolute index.
        subgoal_index: ``(N,)`` absolute index of every frame's subgoal.
        starts: ``(E,)`` absolute index of every episode's first frame.
        ends: ``(E,)`` one past every episode's last frame.
        present: ``(N,)`` frames that exist locally; an episode that is not whole here is passed over.
        place: The dataset's folder, for the message.

    Raises:
        SegmentationError: Labels and record are out of step.
    """
    lengths = (ends - starts).tolist()
    if lengths != list(record.source.episode_lengths):
        different = [i for i, (a, b) in enumerate(zip(lengths, record.source.episode_lengths, strict=False)) if a != b]
        where = f", and the first of another length is episode {different[0]}" if different else ""
        raise SegmentationError(
            f"The dataset has {len(lengths)} episodes of {sum(lengths)} frames, its segmentation record "
            f"{len(record.episodes)} of {record.source.total_frames}{where}. Episodes were deleted, merged or split "
            f"after the segmentation. {relabelling(place)}"
        )
    for number, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        if not present[start:end].all():
            continue
        offset = subgoal_index[start:end] - np.arange(start, end)
        if label_hash(skill_id[start:end], offset) != record.episodes[number].sha256:
            raise SegmentationError(
                f"The labels of episode {number} (frames {start} to {end - 1}) are not those of the segmentation "
                f"record. Episodes were reordered or columns changed after the segmentation. {relabelling(place)}"
            )


def load_labels(root: Path) -> tuple[SegmentationRecord, IntArray, IntArray]:
    """Reads the labels of a segmented dataset and makes sure that they belong to it.

    Args:
        root: Folder of the dataset; a partial download will do.

    Returns:
        The record, and ``skill_id`` and ``subgoal_index``, ``(N,)`` int64 each, in the order of the absolute index; -1
        for frames that do not exist locally.

    Raises:
        SegmentationError: The dataset is not segmented, or labels and dataset are out of step.
        DatasetError: The dataset is damaged, or lacks the label columns.
    """
    from lerobot_buds.data import read_table  # imports LeRobot, hence torch

    record = SegmentationRecord.read(root)
    table = read_table(root, [SKILL_ID, SUBGOAL_INDEX])
    skill_id, subgoal_index = table.columns[SKILL_ID], table.columns[SUBGOAL_INDEX]
    check_labels(record, skill_id, subgoal_index, table.starts, table.ends, table.present, table.root)
    return record, skill_id, subgoal_index
