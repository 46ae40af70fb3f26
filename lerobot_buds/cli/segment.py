"""``lerobot-buds-segment``: discovers skills in a LeRobotDataset and writes a labelled copy of it."""

import logging
from dataclasses import asdict, dataclass, field
from pathlib import Path

import torch

from lerobot_buds.core import ACTION, STATE, TRUE_STAGE, ConfigError, IntArray, frames_of_seconds, remove_leftovers
from lerobot_buds.demos import DatasetFiles, check_demonstrations, only_writer, read_table
from lerobot_buds.evaluation import Agreement, agreement
from lerobot_buds.representation import (
    Representation,
    RepresentationConfig,
    draw_reconstructions,
    encode_dataset,
    train_representation,
)
from lerobot_buds.segmentation import (
    DiscoveryConfig,
    SegmentationRecord,
    check_target,
    draw_timeline,
    write_segmented_dataset,
)

from .running import dataset_root, parse, run

logger = logging.getLogger(__name__)


@dataclass
class SegmentConfig:
    """Settings of a segmentation pass."""

    repo_id: str
    """The dataset to segment; it is only read."""

    root: str | None = None
    """Its folder; None for LeRobot's own place for `repo_id`, where it is downloaded if it is missing."""

    output_repo_id: str | None = None
    """Name of the labelled copy; None for `repo_id` with ``_skills`` behind it."""

    output_root: str | None = None
    """Its folder, which must not exist; None for LeRobot's own place for its name."""

    work_dir: str | None = None
    """Keeps the representation and the pictures; None for ``outputs/segment/`` and the copy's name."""

    subgoal_horizon_s: float = 1.5
    """How far ahead a subgoal lies at most (seconds). Implementation notes: 1.5; multi-task 1.0."""

    representation: RepresentationConfig = field(default_factory=RepresentationConfig)
    """Settings of the representation that is trained."""

    representation_path: str | None = None
    """A finished representation to use instead: its folder, or its repository on the Hub."""

    discovery: DiscoveryConfig = field(default_factory=DiscoveryConfig)
    """Settings of skill discovery."""


def segment(config: SegmentConfig) -> SegmentationRecord | None:
    """Runs the whole pass; an interrupted one goes on where it was. What cannot work is refused before the training.

    Returns:
        What was found; None in all but the first process of ``accelerate launch``, which share the training alone.

    Raises:
        DatasetError: The dataset is damaged or incomplete, or another process is at the same work or output.
        SegmentationError: It cannot be segmented as asked, or the output exists.
        StorageError: The working folder cannot be written.
        ConfigError: A setting cannot work.
        CheckpointError: The representation cannot be had, or does not fit the dataset.
    """
    root = local_root(config.repo_id, config.root)
    output_repo_id = config.output_repo_id or f"{config.repo_id}_skills"
    work_dir = Path(config.work_dir or Path("outputs/segment") / output_repo_id)
    output = dataset_root(output_repo_id, config.output_root)
    _check(config, root, output, work_dir)
    with only_writer(work_dir):
        for folder in (work_dir, work_dir / "representation"):
            remove_leftovers(folder)
        record = _discover(config, root, work_dir)
        if record is not None:
            write_segmented_dataset(root, output, output_repo_id, record)
    logger.info("Pictures are in %s.", work_dir)
    return record


def _check(config: SegmentConfig, root: Path, output: Path, work_dir: Path) -> None:
    """Refuses what cannot work, what takes least time to find out first."""
    if not config.subgoal_horizon_s > 0:
        raise ConfigError(f"subgoal_horizon_s={config.subgoal_horizon_s} must be positive.")
    if work_dir.resolve().is_relative_to(root.resolve()):
        raise ConfigError(f"work_dir={work_dir} lies in {root}, which is only read; choose a folder outside.")
    files = DatasetFiles(root)
    config.discovery.build(files.fps).check([int(episode["length"]) for episode in files.episodes])
    check_target(root, output)


def _discover(config: SegmentConfig, root: Path, work_dir: Path) -> SegmentationRecord | None:
    """Trains the representation, finds the skills in its latents and leaves the pictures in the working folder."""
    files = DatasetFiles(root)
    representation = _representation(config, root, work_dir)
    if torch.distributed.is_initialized() and torch.distributed.get_rank() > 0:
        return None
    if representation.draws:
        draw_reconstructions(root, representation, work_dir / "reconstructions.png")
    latents = encode_dataset(root, representation)
    fps = files.fps
    labels = config.discovery.build(fps).fit(latents).labels_
    stages = true_stages(root) if TRUE_STAGE in files.features else None
    scores = agreement(labels, stages, fps) if stages else None
    record = SegmentationRecord.of_labels(
        labels,
        repo_id=config.repo_id,
        fps=fps,
        horizon=frames_of_seconds(config.subgoal_horizon_s, fps),
        parameters=asdict(config.discovery),
        seeds={"representation": representation.config.seed, "discovery": config.discovery.seed},
        representation=_describe(representation),
        agreement=asdict(scores) if scores else None,
    )
    draw_timeline(work_dir / "timeline.png", labels, fps, stages, _title(record, scores))
    return record


def main() -> None:
    """Entry point of the console script."""
    config = parse(SegmentConfig)
    record = run(lambda: segment(config))
    if record is None:
        return
    print(f"{record.n_skills} skills in {len(record.episodes)} demonstrations")
    for number, skill in enumerate(record.skills):
        print(f"  skill {number}: {skill['segments']:.0f} segments of {skill['mean_seconds']:.1f} s on average")
    if record.agreement:
        print("  agreement with the true stages: " + _in_words(Agreement(**record.agreement)))


def local_root(repo_id: str, root: str | None) -> Path:
    """Tells where a dataset lies on this machine, after downloading it where it is missing and has no folder given."""
    place = dataset_root(repo_id, root)
    if not (place / "meta" / "info.json").exists() and root is None:
        from lerobot.datasets import LeRobotDataset

        place = Path(LeRobotDataset(repo_id).root)
    return place


def true_stages(root: Path) -> list[IntArray]:
    """Reads the true stage of every frame, ``(T,)`` per demonstration."""
    table = read_table(root, [TRUE_STAGE])
    column = table.columns[TRUE_STAGE]
    return [column[start:end] for start, end in zip(table.starts, table.ends, strict=True)]


def _representation(config: SegmentConfig, root: Path, work_dir: Path) -> Representation:
    """Checks the demonstrations, and trains a representation on them or takes the finished one."""
    # The actions are not used here, but the policy that learns from the result needs them.
    if config.representation_path is None:
        columns = [*([STATE] if config.representation.proprioception else []), ACTION]
        check_demonstrations(root, config.representation.cameras, columns)
        return train_representation(root, config.representation, work_dir / "representation")
    if config.representation != RepresentationConfig():
        raise ConfigError(
            f"representation_path={config.representation_path!r} is used as it is, so that settings of a new "
            "representation have no effect: leave out either it or representation.* (also in the settings file)."
        )
    representation = Representation.from_pretrained(config.representation_path)
    columns = [*([STATE] if representation.modalities.state_dims else []), ACTION]
    check_demonstrations(root, list(representation.modalities.cameras), columns)
    return representation


def _describe(representation: Representation) -> dict[str, object]:
    return {"hash": representation.hash, **asdict(representation.config)}


def _title(record: SegmentationRecord, scores: Agreement | None) -> str:
    title = f"{record.source.repo_id}: {record.n_skills} skills in {len(record.episodes)} demonstrations"
    return f"{title}\n{_in_words(scores)} against the true stages" if scores else title


def _in_words(scores: Agreement) -> str:
    return f"boundary F1 {scores.boundary_f1:.2f} (within {scores.tolerance_s} s), NMI {scores.nmi:.2f}"
