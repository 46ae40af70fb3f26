"""``lerobot-buds-segment``: discovers skills in a LeRobotDataset and writes a labelled copy of it."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from lerobot_buds.core import (
    ACTION,
    LANGUAGE_COLUMNS,
    STATE,
    TRUE_STAGE,
    ConfigError,
    IntArray,
    frames_of_seconds,
    remove_leftovers,
)
from lerobot_buds.data import (
    GivenLabels,
    LocalDataset,
    check_demonstrations,
    commit_of,
    content_hashes,
    given_labels,
    only_writer,
    true_stages,
)
from lerobot_buds.evaluation import agreement
from lerobot_buds.representation import (
    Representation,
    RepresentationConfig,
    draw_reconstructions,
    encode_dataset,
    is_main_process,
    train_representation,
)
from lerobot_buds.segmentation import (
    DiscoveredSkills,
    DiscoveryConfig,
    SegmentationRecord,
    SkillModel,
    automatic_names,
    check_target,
    discover_skills,
    draw_silhouettes,
    draw_timeline,
    given_skills,
    preset,
    share_dataset,
    write_segmented_dataset,
)

from .datasets import DatasetOptions
from .running import dataset_root, parse, run

logger = logging.getLogger(__name__)


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


def segment(config: SegmentConfig) -> SegmentationRecord | None:
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
    dataset = config.open()
    output_repo_id = f"{config.repo_id}_skills" if config.output_repo_id is None else config.output_repo_id
    work_dir = Path("outputs/segment") / output_repo_id if config.work_dir is None else Path(config.work_dir)
    output = dataset_root(output_repo_id, config.output_root)
    if not is_main_process(config.representation):
        _take_share(config, dataset, work_dir)
        return None
    _check(config, dataset, output, work_dir)
    given = None if config.labels_from is None else given_labels(dataset, config.labels_from)
    if given is None and LANGUAGE_COLUMNS[0] in dataset.features:
        logger.info("Language annotations stay as they are; --labels_from=subtasks would make skills of subtasks.")
    with only_writer(work_dir):
        for folder in (work_dir, work_dir / "representation"):
            remove_leftovers(folder)
        if config.representation_only:
            _represent(config, dataset, work_dir)
            return None
        found = _discover(config, dataset, work_dir, given)
        stages = true_stages(dataset) if TRUE_STAGE in dataset.features else None
        record = _record(config, dataset, found, stages)
        names = automatic_names(record, dataset, found.model.names) if given is None else given.names
        _draw(record, found, dataset, work_dir, stages, names)
        write_segmented_dataset(dataset, output, output_repo_id, record, found.model, names)
    if config.push_to_hub:
        logger.info("Sent to %s.", share_dataset(output, output_repo_id, config.private, config.branch))
    logger.info("Pictures are in %s.", work_dir)
    return record


def _take_share(config: SegmentConfig, dataset: LocalDataset, work_dir: Path) -> None:
    """Helps the first process of ``accelerate launch`` with training and encoding."""
    if config.library is not None:
        representation = SkillModel.from_pretrained(config.library).representation
    elif config.representation_path is not None:
        representation = Representation.from_pretrained(config.representation_path)
    else:
        representation = train_representation(dataset, config.representation, work_dir / "representation")
    encode_dataset(dataset, representation)


def _represent(config: SegmentConfig, dataset: LocalDataset, work_dir: Path) -> None:
    """Trains the representation and encodes the dataset, for segmentations to come."""
    wanted = config.representation
    _check_data(dataset, wanted.cameras, wanted.proprioception != [], wanted.side)
    representation = train_representation(dataset, wanted, work_dir / "representation")
    encode_dataset(dataset, representation)
    if representation.draws:
        draw_reconstructions(dataset, representation, work_dir / "reconstructions.png")
    if config.push_to_hub:
        name = config.output_repo_id or f"{config.repo_id}_representation"
        logger.info("Sent to %s.", representation.push_to_hub(name, config.private, config.branch))
    logger.info("The representation is in %s: use it by --representation_path.", work_dir / "representation")


def _check(config: SegmentConfig, dataset: LocalDataset, output: Path, work_dir: Path) -> None:
    """Refuses what cannot work, what takes least time to find out first."""
    if not config.subgoal_horizon_s > 0:
        raise ConfigError(f"subgoal_horizon_s={config.subgoal_horizon_s} must be positive.")
    if config.grow and config.library is None:
        raise ConfigError("grow=true opens new skills beside those of a library, but there is no library.")
    if config.representation_only and (config.library or config.representation_path):
        raise ConfigError("representation_only=true trains one: leave out library and representation_path.")
    if config.labels_from is not None and (config.library is not None or config.representation_only):
        raise ConfigError("labels_from makes skills of labels: leave out library and representation_only.")
    if work_dir.resolve().is_relative_to(dataset.root.resolve()):
        raise ConfigError(f"work_dir={work_dir} lies in {dataset.root}, which is only read; choose a folder outside.")
    for name, place, unused in (
        ("library", config.library, ("representation", "discovery", "representation_path", "preset")),
        ("representation_path", config.representation_path, ("representation",)),
        ("labels_from", config.labels_from, ("discovery", "preset")),
    ):
        changed = [n for n in unused if getattr(config, n) != getattr(SegmentConfig(config.repo_id), n)]
        if place is not None and changed:
            raise ConfigError(
                f"{name}={place!r} is used as it is, so that the settings {changed} have no effect: leave out either "
                "it or them (also in the settings file)."
            )
    _discovery(config).build(dataset.fps).check([int(episode["length"]) for episode in dataset.episodes])
    if not config.representation_only:
        check_target(dataset, output)


def _discover(
    config: SegmentConfig, dataset: LocalDataset, work_dir: Path, given: GivenLabels | None
) -> DiscoveredSkills:
    """Labels the demonstrations with the skills of a library, with labels that are there, or with what is found."""
    if config.library is not None:
        model = SkillModel.from_pretrained(config.library)
        _check_representation(dataset, model.representation)
        return model.label(dataset, config.grow)
    representation: Representation | RepresentationConfig = config.representation
    if config.representation_path is not None:
        representation = Representation.from_pretrained(config.representation_path)
        _check_representation(dataset, representation)
    else:
        wanted = config.representation
        _check_data(dataset, wanted.cameras, wanted.proprioception != [], wanted.side)
    if given is not None:
        return given_skills(dataset, given.labels, len(given.names), representation, _discovery(config), work_dir)
    return discover_skills(dataset, representation, _discovery(config), work_dir)


def _discovery(config: SegmentConfig) -> DiscoveryConfig:
    return preset(config.preset, config.discovery)


def _check_representation(dataset: LocalDataset, representation: Representation) -> None:
    fused = representation.modalities
    _check_data(dataset, list(fused.cameras), bool(fused.state_dims), representation.config.side)


def _check_data(dataset: LocalDataset, cameras: list[str] | None, with_state: bool, side: int) -> None:
    # The actions are not used here, but the policy that learns from the result needs them.
    check_demonstrations(dataset, cameras, [STATE, ACTION] if with_state else [ACTION], side=side)


def _record(
    config: SegmentConfig, dataset: LocalDataset, found: DiscoveredSkills, stages: list[IntArray] | None
) -> SegmentationRecord:
    model, fps = found.model, dataset.fps
    library = config.library and {"name": config.library, "grown": config.grow, "lineage": list(model.lineage)}
    if library and model.commit is not None:
        library["commit"] = model.commit
    network = model.representation
    place = {} if network.commit is None else {"repo_id": config.representation_path, "commit": network.commit}
    return SegmentationRecord.of_labels(
        found.labels,
        repo_id=config.repo_id,
        fps=fps,
        horizon=frames_of_seconds(config.subgoal_horizon_s, fps),
        n_skills=found.n_skills,
        commit=commit_of(dataset.root),
        chosen=dataset.chosen,
        content=[digest for digest in content_hashes(dataset) if digest is not None],
        parameters=asdict(model.config),
        seeds={"representation": model.representation.config.seed, "discovery": model.config.seed},
        representation={"hash": network.hash, **place, **asdict(network.config)},
        agreement=asdict(agreement(found.labels, stages, fps)) if stages else None,
        labels_from=config.labels_from,
        library=library or None,
        silhouettes={str(count): score for count, score in found.scores.items()} or None,
        stability=found.stability,
    )


def _draw(
    record: SegmentationRecord,
    found: DiscoveredSkills,
    dataset: LocalDataset,
    work_dir: Path,
    stages: list[IntArray] | None,
    names: Sequence[str],
) -> None:
    if found.model.representation.draws:
        draw_reconstructions(dataset, found.model.representation, work_dir / "reconstructions.png")
    title = f"{record.source.repo_id}: {record.n_skills} skills in {len(record.episodes)} demonstrations"
    if record.agreement:
        title += f"\n{_in_words(record.agreement)} against the true stages"
    draw_timeline(work_dir / "timeline.png", found.labels, record.source.fps, stages, title, names)
    if found.scores:
        draw_silhouettes(work_dir / "n_skills.png", found.scores)


def main() -> None:
    """Entry point of the console script."""
    config = parse(SegmentConfig)
    record = run(lambda: segment(config))
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
        print("  agreement with the true stages: " + _in_words(record.agreement))


def _in_words(scores: Mapping[str, float]) -> str:
    return f"boundary F1 {scores['boundary_f1']:.2f} (within {scores['tolerance_s']} s), NMI {scores['nmi']:.2f}"
