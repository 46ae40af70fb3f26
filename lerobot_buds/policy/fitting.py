"""Fits a configuration to the dataset the policy is built for, and refuses what does not fit together."""

import logging
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lerobot.configs import FeatureType, PolicyFeature
from lerobot.utils.feature_utils import dataset_to_policy_features

from lerobot_buds.core import (
    RENDER_PROFILES,
    STATE,
    CheckpointError,
    ConfigError,
    dims_used,
    near_names,
    same_rate,
)
from lerobot_buds.data import Origin, read_collection
from lerobot_buds.segmentation import load_labels

from .actions import ActionRange, choose_coding
from .configuration_buds import PAPER_FPS, BudsConfig, refuse_other_images
from .labels import representation_of
from .library import TrainedSkills

logger = logging.getLogger(__name__)

_OTHER_LABELS = (
    " Its skill ids need not mean the same. If they do (both come from one partition), pass --policy.segmentation=null."
)


def complete(config: BudsConfig, meta: Any, library: TrainedSkills | None, from_checkpoint: bool) -> ActionRange | None:
    """Fills all open fields of a configuration.

    Args:
        config: Changed in place.
        meta: LeRobot's metadata of the dataset to train on, or None.
        library: Skills that are taken over.
        from_checkpoint: Weights will be loaded: the configuration is that of a checkpoint.

    Returns:
        The actions of the dataset.

    Raises:
        ConfigError: The configuration cannot work with the features or the actions.
        SegmentationError: The dataset has no valid labels.
        CheckpointError: The configuration of a checkpoint or of the library does not fit the dataset.
    """
    if library is not None:
        library.adopt(config)
    if not from_checkpoint:
        config.limit_image_size()
    config.validate_features()
    found = None
    if meta is None:
        fit_without_dataset(config)
    else:
        fit_to_dataset(config, meta, may_be_renamed=from_checkpoint)
        found = ActionRange.read(Path(meta.root))
    if found is not None and library is None and not from_checkpoint:
        choose_coding(config, found)
    return found


def fit_to_dataset(config: BudsConfig, meta: Any, may_be_renamed: bool = False) -> None:
    """Fills the configuration's open fields from a segmented dataset, and checks those that a checkpoint has filled.

    Args:
        config: Changed in place; LeRobot saves this very object with the checkpoint.
        meta: LeRobot's dataset metadata.
        may_be_renamed: The dataset may have other names for cameras, which ``--rename_map`` translates in the batches.

    Raises:
        SegmentationError: The policy has skills as labelled, and the dataset has no valid labels.
        CheckpointError: Number of skills, labels, frame rate, cameras or state differ from what the configuration says.
        ConfigError: The dataset has tasks that the configuration does not know.
    """
    _check_features(config, meta, may_be_renamed)
    _check_depth(config, meta)
    if config.skills == "segments":
        record, _, _ = load_labels(meta.root)
        config.n_skills = _agree("n_skills", config.n_skills, int(record.n_skills), meta.root)
        if config.segmentation not in record.lineage:  # else the dataset's skills are those of the policy
            labels = record.labels_hash
            config.segmentation = _agree("segmentation", config.segmentation, labels, meta.root, _OTHER_LABELS)
        if config.subgoal_space == "latent":
            representation = representation_of(Path(meta.root))
            config.representation = _agree("representation", config.representation, representation.hash, meta.root)
            config.subgoal_dim = representation.width
    else:
        config.n_skills = _agree("n_skills", config.n_skills, 1, meta.root)
    config.parents = {**config.parents, "dataset": Origin.of(meta).known}
    fps = float(meta.fps)
    if config.fps is None or not same_rate(config.fps, fps):
        config.fps = _agree("fps", config.fps, fps, meta.root)
    if (profile := read_collection(Path(meta.root)).get("render_profile")) is not None:
        config.render_profile = _agree("render_profile", config.render_profile, profile, meta.root)
    names = state_names(meta.features)
    config.state_names = _agree("state_names", config.state_names or None, names, meta.root)
    tasks = [str(task) for task in meta.tasks.index]
    config.tasks = config.tasks or tasks
    for task in tasks:
        task_number(config, task)
    choose_state(config)


def fit_without_dataset(config: BudsConfig) -> None:
    """Completes a configuration that no dataset has filled: an untrained policy for trying out an environment."""
    if config.n_skills is None or config.fps is None:
        logger.warning("Policy 'buds' was built without a dataset: it is untrained, has one skill and assumes 20 Hz.")
    config.n_skills = config.n_skills or 1
    config.fps = config.fps or float(PAPER_FPS)
    config.action_scaling = config.action_scaling or "none"
    config.binary_dims = config.binary_dims or []
    choose_state(config)


def choose_state(config: BudsConfig) -> None:
    """Chooses the dimensions of the state, where that has not been done, and says which they are.

    Args:
        config: Changed in place.

    Raises:
        ConfigError: A pattern matches nothing, or a given dimension is outside the state.
    """
    names = config.state_names or [str(d) for d in range(config.state_size)]
    if config.current_dims is None:
        config.current_dims = dims_used("current_state", names, config.current_state, ours=["joint*"])
    if config.history_dims is None:
        config.history_dims = dims_used("history_state", names, config.history_state, ours=["gripper*"], others=[])
    used = {*config.current_dims, *config.history_dims}
    if outside := [d for d in used if not 0 <= d < config.state_size]:
        raise ConfigError(f"State dimensions {outside} do not exist: the state has {config.state_size}.")
    logger.info(
        "Of the state, the skills read %s now, %s of the last %g s, and do not read %s.",
        [names[d] for d in config.current_dims],
        [names[d] for d in config.history_dims],
        config.gripper_history_s,
        [name for d, name in enumerate(names) if d not in used],
    )


def state_names(features: dict[str, Any]) -> list[str]:
    """Lists the names of the state's dimensions; empty where the dataset does not name each.

    Args:
        features: LeRobot's features; ``names`` is a list, or a dictionary of lists, or None.
    """
    if STATE not in features:
        return []
    names = features[STATE].get("names") or []
    if isinstance(names, dict):
        names = [name for group in names.values() if isinstance(group, list) for name in group]
    complete = len(names) == features[STATE]["shape"][0]
    return [str(name) for name in names] if complete else []


def task_number(config: BudsConfig, task: str) -> int:
    """Looks a task up; no task at all is fine where there is just one.

    Args:
        config: Its `tasks` are the known ones; where it knows none (an untrained policy), all pass.
        task: Task string.

    Returns:
        Its position among the tasks of the configuration.

    Raises:
        ConfigError: The task is unknown.
    """
    if task in config.tasks:
        return config.tasks.index(task)
    if not config.tasks or (task == "" and len(config.tasks) == 1):
        return 0
    known = near_names(task, config.tasks)
    raise ConfigError(f"The policy does not know the task {task!r}. {known} To train on others too, set policy.tasks.")


def check_tasks(config: BudsConfig, trained: BudsConfig) -> None:
    """Refuses tasks for which the weights of a checkpoint have another shape, or are those of another task.

    Args:
        config: What the checkpoint is to be used with.
        trained: Its own configuration.

    Raises:
        ConfigError: Tasks have other numbers than in the checkpoint, or were added where that cannot be.
    """
    if any(task in config.tasks and config.tasks.index(task) != n for n, task in enumerate(trained.tasks)):
        raise ConfigError(
            f"tasks={config.tasks} changes the order of the checkpoint's tasks, {trained.tasks}, by which the policy "
            "tells them apart. Keep it, and put new tasks at the end."
        )
    if _tasks_in_weights(config) != _tasks_in_weights(trained):
        library = ", or take the skills over with policy.skills_path" if trained.has_subgoals else ""
        raise ConfigError(
            f"tasks={config.tasks} does not fit the checkpoint of tasks {trained.tasks}: one network knows them all, "
            f"and none can be added to it or left out. Train a new policy on all tasks{library}. Only a policy with a "
            "meta controller for every task (meta_controllers='per_task') can be given more."
        )


def _tasks_in_weights(config: BudsConfig) -> int:
    """Counts the tasks that one network is told apart; 0 where every task has a network of its own."""
    if not config.has_subgoals:
        return config.task_count
    return max(1, len(config.tasks)) if config.meta_controllers == "conditioned" else 0


def check_observation(config: BudsConfig, observation: Mapping[str, Any]) -> None:
    """Refuses observations of a simulator that runs or draws otherwise than where the demonstrations come from.

    Args:
        config: See `check_environment`.
        observation: May hold ``observation.control_rate`` (steps per second) and ``observation.render_profile`` (its
            number), ``(B, 1)`` each; a robot or another environment does not tell.

    Raises:
        CheckpointError: Rates or profiles differ; both are named.
    """
    rate, profile = (observation.get(f"observation.{name}") for name in ("control_rate", "render_profile"))
    check_environment(
        config,
        None if rate is None else float(rate.flatten()[0]),
        None if profile is None else RENDER_PROFILES[int(profile.flatten()[0])],
    )


def check_environment(config: BudsConfig, rate: float | None, profile: str | None) -> None:
    """Refuses an environment that runs or draws otherwise than where the demonstrations come from.

    Args:
        config: Its `fps` and `render_profile` are those of the demonstrations; where they are not known, all pass.
        rate: Control steps per second; None where nobody tells.
        profile: Render profile; None where nobody tells.

    Raises:
        CheckpointError: Rates or profiles differ; both are named.
    """
    if rate is not None and config.fps is not None and not same_rate(rate, config.fps):
        raise CheckpointError(
            f"The policy was trained at {config.fps:g} frames a second, the environment runs at {rate:g} control "
            "steps. Actions of one rate mean nothing at another."
        )
    if profile is not None and config.render_profile is not None and profile != config.render_profile:
        raise CheckpointError(
            f"The policy was trained on images of the render profile {config.render_profile!r}, the environment draws "
            f"{profile!r}. Use --env.render_profile={config.render_profile}."
        )


def _check_features(config: BudsConfig, meta: Any, may_be_renamed: bool) -> None:
    stored = dataset_to_policy_features(meta.features)
    missing = [key for key in config.input_features if key not in stored]
    if missing and not (may_be_renamed and _could_be_renamed(config, missing, stored)):
        raise CheckpointError(f"The policy needs {missing}, which {meta.root} lacks. It has {sorted(stored)}.")
    for key, feature in config.input_features.items():
        expected, found = tuple(feature.shape), tuple(stored.get(key, feature).shape)
        if expected != found:
            raise CheckpointError(f"{key}: the policy was made for shape {expected}, {meta.root} has {found}.")
    if missing:
        logger.info("%s lacks %s: other cameras are expected to bear these names in the batches.", meta.root, missing)


def _could_be_renamed(config: BudsConfig, missing: list[str], stored: Mapping[str, PolicyFeature]) -> bool:
    """Tells whether a dataset has as many cameras to spare, shape by shape, as are missing by name."""
    images = config.image_features
    if not set(missing) <= set(images):
        return False
    spare = [f for key, f in stored.items() if f.type is FeatureType.VISUAL and key not in images]
    return Counter(tuple(images[key].shape) for key in missing) <= Counter(tuple(f.shape) for f in spare)


def _check_depth(config: BudsConfig, meta: Any) -> None:
    images = config.image_features  # LeRobot hands depth maps over with one channel, whatever number was declared
    refuse_other_images(images, [key for key in images if key in meta.depth_keys])


def _agree[T](name: str, configured: T | None, stored: T, root: Any, remedy: str = "") -> T:
    if configured is not None and configured != stored:
        raise CheckpointError(f"The policy was made for {name}={configured!r}, but {root} has {stored!r}.{remedy}")
    return stored
