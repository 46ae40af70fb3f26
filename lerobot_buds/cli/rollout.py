"""``lerobot-buds-rollout``: runs a policy in a robosuite task, and shows what it decides and where it fails."""

import os
from dataclasses import dataclass, field
from itertools import batched
from pathlib import Path
from typing import Any

from lerobot.envs import EnvConfig
from tqdm import tqdm

from lerobot_buds.core import ConfigError, DatasetError, near_names, remove_leftovers
from lerobot_buds.data import only_writer
from lerobot_buds.envs import EpisodeVectorEnv, Task, tasks_named
from lerobot_buds.envs.configuration_robosuite import RobosuiteEnvConfig
from lerobot_buds.evaluation import (
    FAILURE_WINDOW_S,
    META_CONTROLLER,
    NEIGHBORS,
    SKILL_SOURCES,
    STAGES,
    SUBGOAL_SOURCES,
    Checkpoint,
    Decider,
    EpisodeRecorder,
    Guide,
    RolloutRecord,
    draw_ribbons,
    episode_frames,
    failures_of,
    load_checkpoint,
    run_episodes,
    summarise,
    summary_table,
    write_video,
)

from .running import parse, run


@dataclass
class RolloutConfig:
    """Settings of a run."""

    policy_path: str
    """The checkpoint: its folder (``.../pretrained_model``) or its repository on the Hub."""

    output_dir: Path
    """Folder of the record, the picture and the videos; what it holds already is not run again."""

    env: EnvConfig = field(default_factory=RobosuiteEnvConfig)
    """The environment, as for ``lerobot-eval``: ``--env.type=robosuite --env.task=...``; one task."""

    dataset_root: Path | None = None
    """Folder of the segmented dataset that the policy was trained on; without it failures are not classified."""

    episodes: int = 20
    """Number of episodes."""

    seed: int = 500_000
    """Seed of the first episode, of its start and of the meta controller's noise; each further one takes the next."""

    batch_size: int = 0
    """Environments at once; 0 for one a core."""

    device: str | None = None
    """Where to compute; None for what the checkpoint says."""

    skills_from: str = META_CONTROLLER
    """Who chooses the skill: ``meta_controller``, ``demonstrations`` (those nearest), or ``stages`` (those nearest that
    are in the same true stage)."""

    subgoals_from: str = META_CONTROLLER
    """Who chooses the subgoal: ``meta_controller`` or ``demonstrations``."""

    neighbors: int = NEIGHBORS
    """Demonstrations that are asked at a decision."""

    failure_window_s: float = FAILURE_WINDOW_S
    """How long after its last progress the decisions of a failed episode are judged (seconds)."""

    video: bool = True
    """Writes a video of every episode, for which its images are held in memory (0.1 MB a step)."""


def roll_out(config: RolloutConfig) -> RolloutRecord:
    """Runs the episodes that are missing; an interrupted run loses those in flight and nothing else.

    Raises:
        ConfigError: A setting cannot work, or the folder holds rollouts of other settings.
        CheckpointError: The checkpoint cannot be had, or does not fit the environment or the dataset.
        DatasetError: The dataset or an earlier record is damaged, or another process is at the same folder.
        SegmentationError: The dataset is not segmented.
        SimulatorError: Not a single environment could start.
    """
    env, task = _environment(config.env)
    _check(config)
    checkpoint = load_checkpoint(config.policy_path, env, task, config.device)
    guide = _guide(config, task, checkpoint)
    policy = checkpoint.policy.config
    record = RolloutRecord(
        settings=_settings(config, env, task, checkpoint, guide),
        task=task.name,
        stages=task.stages,
        fps=env.fps,
        n_skills=policy.n_skills or 1,
        period=policy.meta_period,
    )
    with only_writer(config.output_dir):
        for folder in (config.output_dir, config.output_dir / "videos"):
            remove_leftovers(folder)
        record = _run(config, env, task, checkpoint, guide, record.resumed(config.output_dir))
        if any(episode.length for episode in record.episodes):
            draw_ribbons(config.output_dir / "ribbons.png", record)
    return record


def _environment(env: EnvConfig) -> tuple[RobosuiteEnvConfig, Task]:
    if not isinstance(env, RobosuiteEnvConfig):
        raise ConfigError(f"env.type={env.type!r} does not tell its stages; only 'robosuite' does.")
    tasks = tasks_named(env.task)
    if len(tasks) != 1:
        raise ConfigError(f"env.task={env.task!r} names {len(tasks)} tasks; look into one at a time.")
    return env, tasks[0]


def _check(config: RolloutConfig) -> None:
    for name, known in (("skills_from", SKILL_SOURCES), ("subgoals_from", SUBGOAL_SOURCES)):
        source = getattr(config, name)
        if source not in known:
            raise ConfigError(f"{name}={source!r} is unknown. {near_names(source, known)}")
        if source != META_CONTROLLER and config.dataset_root is None:
            raise ConfigError(f"{name}={source!r} asks demonstrations; give their segmented dataset by dataset_root.")
    for name, least in (("episodes", 1), ("seed", 0), ("batch_size", 0), ("neighbors", 1)):
        if getattr(config, name) < least:
            raise ConfigError(f"{name}={getattr(config, name)} cannot work; it must be at least {least}.")
    if not config.failure_window_s > 0:
        raise ConfigError(f"failure_window_s={config.failure_window_s} must be positive.")


def _guide(config: RolloutConfig, task: Task, checkpoint: Checkpoint) -> Guide | None:
    if config.dataset_root is None:
        return None
    guide = Guide.open(config.dataset_root, task, checkpoint.policy.config, config.neighbors, checkpoint.renamed)
    if config.skills_from == STAGES and not len(guide.stages):
        raise DatasetError(
            f"{config.dataset_root} does not tell the stages of {task.name}: skills_from=stages needs them."
        )
    return guide


def _settings(
    config: RolloutConfig, env: RobosuiteEnvConfig, task: Task, checkpoint: Checkpoint, guide: Guide | None
) -> dict[str, Any]:
    """Lists all that decides what happens in an episode of a given seed, and how it is judged."""
    return {
        "checkpoint": checkpoint.sha256,
        "labels": guide and guide.labels,
        "representation": guide and guide.representation.hash,
        "task": task.name,
        "episode_length": task.max_steps if env.episode_length is None else env.episode_length,
        **{name: getattr(env, name) for name in ("image_size", "render_profile", "released")},
        **{
            name: getattr(config, name)
            for name in ("seed", "skills_from", "subgoals_from", "neighbors", "failure_window_s")
        },
    }


def _run(
    config: RolloutConfig,
    env: RobosuiteEnvConfig,
    task: Task,
    checkpoint: Checkpoint,
    guide: Guide | None,
    record: RolloutRecord,
) -> RolloutRecord:
    """Runs what is missing, batch by batch, and writes the record after each."""
    finished = record.finished_seeds
    seeds = [seed for seed in range(config.seed, config.seed + config.episodes) if seed not in finished]
    decider = Decider(checkpoint.policy, guide, config.skills_from, config.subgoals_from)
    envs: EpisodeVectorEnv | None = None
    with tqdm(total=len(seeds), desc="episodes", unit="episode", dynamic_ncols=True) as bar:
        try:
            for batch in batched(seeds, config.batch_size or len(os.sched_getaffinity(0))):
                if envs is None or envs.num_envs != len(batch):
                    envs = _make_envs(env, len(batch), envs)
                recorders = [EpisodeRecorder(task, seed, config.video) for seed in batch]
                run_episodes(envs, checkpoint, decider, recorders, bar.update)
                for recorder in recorders:
                    _write_video(config.output_dir / "videos", recorder, record)
                record = record.with_episodes([recorder.episode() for recorder in recorders])
                _write(config.output_dir, record)
                bar.set_postfix(success=sum(episode.success for episode in record.episodes))
        finally:
            if envs is not None:
                envs.close()
    return record


def _make_envs(env: RobosuiteEnvConfig, count: int, before: EpisodeVectorEnv | None) -> EpisodeVectorEnv:
    """Makes the environments of ``lerobot-eval``, each in a process of its own; the last batch may be a small one."""
    if before is not None:
        before.close()
    ((group,),) = (suite.values() for suite in env.create_envs(count, use_async_envs=True).values())
    assert isinstance(group, EpisodeVectorEnv)
    return group


def _write(folder: Path, record: RolloutRecord) -> None:
    failures = {str(e.seed): f for e, f in zip(record.episodes, failures_of(record), strict=True) if f is not None}
    record.write(folder, summary=summarise(record), failures=failures)


def _write_video(folder: Path, recorder: EpisodeRecorder, record: RolloutRecord) -> None:
    episode = recorder.episode()
    if recorder.pictures and episode.length:
        frames = episode_frames(episode, recorder.pictures, record.stages, record.fps, record.n_skills)
        write_video(folder / f"seed_{episode.seed}.mp4", frames, record.fps)


def main() -> None:
    """Entry point of the console script."""
    config = parse(RolloutConfig)
    record = run(lambda: roll_out(config))
    seeds = [episode.seed for episode in record.episodes]
    print(f"{record.task}, {len(seeds)} episodes, seeds {min(seeds)} to {max(seeds)}")
    print(summary_table(record), end="")
    print(f"Record, picture and videos are in {config.output_dir}.")
