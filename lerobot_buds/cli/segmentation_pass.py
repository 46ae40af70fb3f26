"""What ``lerobot-buds-segment`` does: train, encode, discover, draw and write, each where it is not done yet.

Apart from the command, since it imports all that the work needs.
"""

import logging
from collections.abc import Sequence
from dataclasses import asdict
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

from .running import dataset_root
from .segment import SegmentConfig, in_words

logger = logging.getLogger(__name__)


def run_pass(config: SegmentConfig) -> SegmentationRecord | None:
    """Runs the whole pass, see `segment.segment`."""
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
        title += f"\n{in_words(record.agreement)} against the true stages"
    draw_timeline(work_dir / "timeline.png", found.labels, record.source.fps, stages, title, names)
    if found.scores:
        draw_silhouettes(work_dir / "n_skills.png", found.scores)
