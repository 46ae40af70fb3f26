"""``lerobot-buds-segment``: discovers skills in a LeRobotDataset and writes a labelled copy of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_buds.representation import RepresentationConfig
from lerobot_buds.segmentation import DiscoveryConfig

from .datasets import DatasetOptions
from .running import parse, run

if TYPE_CHECKING:
    from lerobot_buds.segmentation import SegmentationRecord


@dataclass
class SegmentConfig(DatasetOptions):
    """Settings of a segmentation pass."""

    output_repo_id: str | None = None
    """Name of the labelled copy of the chosen episodes; None for `repo_id` with ``_skills`` behind it."""

    output_root: Path | None = None
    """Its folder, which must not exist; None for LeRobot's own place for its name."""

    work_dir: Path | None = None
    """Keeps the representation and the pictures; None for ``outputs/segment/`` and the copy's name."""

    subgoal_horizon_s: float = 1.5
    """How far ahead a subgoal lies at most (seconds). Implementation notes: 1.5; multi-task 1.0."""

    representation: RepresentationConfig = field(default_factory=RepresentationConfig)
    """Settings of the representation that is trained."""

    representation_path: str | None = None
    """A finished representation to use instead: its folder, or its repository on the Hub."""

    representation_only: bool = False
    """Trains the representation, leaves it in `work_dir`, and ends; several segmentations can use it then."""

    discovery: DiscoveryConfig = field(default_factory=DiscoveryConfig)
    """Settings of skill discovery."""

    preset: str = "default"
    """``paper`` or ``released`` make the settings of skill discovery follow those, wherever ours depart."""

    library: str | None = None
    """A segmented dataset, its folder or its repository on the Hub, whose skills are to be used instead of new ones."""

    grow: bool = False
    """Opens new skills for what is far from all skills of the library, which keep their numbers."""

    labels_from: str | None = None
    """Makes skills of labels that are there instead of discovering them: of a column such as ``true_stage``, or of the
    ``subtasks`` that people or lerobot-annotate wrote."""

    push_to_hub: bool = False
    """Sends the copy to the Hub under its name; with `representation_only`, the representation under `output_repo_id`
    or else `repo_id` with ``_representation`` behind it. Later and more: lerobot-buds-share."""

    private: bool | None = None
    """Whether a repository that is new on the Hub is private; the account's own default where None."""

    branch: str | None = None
    """Where to put it in its repository; the main branch where None."""


def segment(config: SegmentConfig) -> "SegmentationRecord | None":
    """Runs the whole pass; an interrupted one goes on where it was. What cannot work is refused before the training.

    Returns:
        What was found; None with `representation_only`, and in all but the first process of ``accelerate launch``,
        which share the training alone.

    Raises:
        DatasetError: The dataset is damaged or incomplete, or another process is at the same work or output.
        SegmentationError: It cannot be segmented as asked, or the output exists.
        StorageError: The working folder cannot be written.
        ConfigError: A setting cannot work.
        CheckpointError: The representation or the library cannot be had, or does not fit the dataset.
    """
    from .segmentation_pass import run_pass

    return run_pass(config)


def main() -> None:
    """Entry point of the console script."""
    config = parse(SegmentConfig)
    record = run(lambda: segment(config))
    from lerobot_buds.representation import leave_processes  # loaded by now

    leave_processes()
    if record is None:
        return
    print(f"{record.n_skills} skills in {len(record.episodes)} demonstrations")
    for number, skill in enumerate(record.skills):
        print(f"  skill {number}: {skill['segments']:.0f} segments of {skill['mean_seconds']:.1f} s on average")
    durations = {name: record.parameters[name] for name in ("window_s", "min_skill_s", "segment_worth")}
    print("  from " + ", ".join(f"{name} {value:.3g}" for name, value in durations.items() if value is not None))
    if record.stability is not None:
        print(f"  stability {record.stability:.2f} (1: the same skills from slightly different demonstrations)")
    if record.agreement:
        print("  agreement with the true stages: " + in_words(record.agreement))


def in_words(scores: Mapping[str, float]) -> str:
    """Writes an agreement with the true stages as one line."""
    return f"boundary F1 {scores['boundary_f1']:.2f} (within {scores['tolerance_s']} s), NMI {scores['nmi']:.2f}"
