"""What has to be run for a cell: a graph of commands, each named by a hash of all that decides its result.

Cells share what they have in common: one recording and one representation serve all numbers of skills.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from lerobot_buds.core import ConfigError, sha256_of_file, sha256_of_json
from lerobot_buds.envs import tasks_named

from .experiment import Cell, Size

FIRST_EVALUATION_SEED = 500_000
"""Demonstrations and tuning use seeds below 100,000; see docs/results.md."""

ROOT = "{root}"
"""Stands for the folder of all stages in a command."""

OWN = "{own}"
"""Stands for a stage's own folder."""


@dataclass(frozen=True)
class Stage:
    """One command.

    Attributes:
        kind: collect, represent, segment, train or evaluate.
        program: A public command, or a script of this project.
        options: Its options.
        inputs: Stages whose results it reads.
        files: Settings files that it reads.
        amount: Options that say how much of the same is wanted. They do not name the stage: more is done by going on.
        result: What the command leaves in the stage's folder at its very end, whole, and refuses to make again.
    """

    kind: str
    program: str
    options: Mapping[str, Any]
    inputs: tuple["Stage", ...] = ()
    files: tuple[Path, ...] = ()
    amount: Mapping[str, Any] = field(default_factory=dict)
    result: str = ""

    @cached_property
    def key(self) -> str:
        """Name of its folder: the kind, and a hash of all that decides the result."""
        content = [self.program, dict(self.options), [sha256_of_file(file) for file in self.files]]
        return f"{self.kind}-{sha256_of_json([self.kind, content])[:12]}"

    @property
    def path(self) -> str:
        """Its folder, as other stages' commands name it."""
        return f"{ROOT}/{self.key}"

    def command(self, root: Path) -> list[str]:
        """Makes the command line.

        Args:
            root: Folder of all stages.
        """
        options = {**self.options, **self.amount}
        words = [f"--{name}={_text(value)}" for name, value in options.items()]
        return [self.program, *(w.replace(ROOT, str(root)).replace(OWN, str(root / self.key)) for w in words)]

    def in_order(self) -> Iterator["Stage"]:
        """Yields all that it needs, itself last; a stage may come several times."""
        for stage in self.inputs:
            yield from stage.in_order()
        yield self


@dataclass(frozen=True)
class Demonstrations:
    """Demonstrations that a stage leaves.

    Attributes:
        stage: The stage.
        folder: Their folder.
        tasks: Names of their tasks, in the order in which their episodes lie in the dataset.
        episodes: Episodes of each.
    """

    stage: Stage
    folder: str
    tasks: tuple[str, ...]
    episodes: int

    def numbers(self, tasks: str) -> list[int] | None:
        """Lists the episodes of some of the tasks; None for all.

        Raises:
            ConfigError: A task is not among them.
        """
        chosen = {task.name for task in tasks_named(tasks)} if tasks else set(self.tasks)
        if missing := chosen - set(self.tasks):
            raise ConfigError(f"There are no demonstrations of {sorted(missing)} among those of {list(self.tasks)}.")
        if chosen == set(self.tasks):
            return None
        return [i * self.episodes + n for i, t in enumerate(self.tasks) if t in chosen for n in range(self.episodes)]

    def only(self, tasks: str) -> tuple[str, ...]:
        """Names those of its tasks, in its order."""
        chosen = {task.name for task in tasks_named(tasks)} if tasks else set(self.tasks)
        return tuple(task for task in self.tasks if task in chosen)


@dataclass(frozen=True)
class Run:
    """All stages of one cell and training seed.

    Attributes:
        cell: The cell.
        size: The size.
        seed: Seed of the training.
        segmentation: The stage that found the skills; None for a policy without.
        training: The stage that trained the policy.
        evaluations: One a task.
    """

    cell: Cell
    size: Size
    seed: int
    segmentation: Stage | None
    training: Stage
    evaluations: tuple[Stage, ...]

    @property
    def stages(self) -> list[Stage]:
        """Every stage once, each behind what it needs."""
        return list({stage.key: stage for last in self.evaluations for stage in last.in_order()}.values())


def plan(cell: Cell, size: Size, seed: int, configs: Path) -> Run:
    """Finds what has to be run for a cell.

    Args:
        cell: The cell.
        size: The size.
        seed: Seed of the training.
        configs: Folder of the settings files.

    Raises:
        ConfigError: The recipe names tasks that are not demonstrated.
    """
    recorded = _collect(cell, size)
    skills = cell.recipe.policy.get("skills", "segments")
    found = _segment(cell, size, recorded, configs) if skills == "segments" else None
    data = found or recorded
    library = None
    if cell.recipe.library:
        library = _train(cell, size, seed, data, cell.recipe.library, {}, configs)
    more = {} if library is None else {"skills_path": _checkpoint(library, size)}
    training = _train(cell, size, seed, data, cell.recipe.trained, more, configs, library)
    judge = data if cell.recipe.judged and found else None
    tasks = [task.name for task in tasks_named(cell.recipe.evaluated)]
    trials = min(cell.recipe.trials, size.most_trials or cell.recipe.trials)
    each = max(1, trials // len(tasks))
    limits = {task: round(limit * cell.recipe.slowness) for task, limit in size.episode_length.items()}
    evaluations = tuple(_evaluate(size, training, task, each, limits.get(task), judge) for task in tasks)
    return Run(cell, size, seed, found.stage if found else None, training, evaluations)


def _collect(cell: Cell, size: Size) -> Demonstrations:
    recipe = cell.recipe
    episodes = min(recipe.episodes, size.most_episodes or recipe.episodes)
    stage = Stage(
        "collect",
        "lerobot-buds-collect",
        {
            "repo_id": "local/demonstrations",
            "root": f"{OWN}/dataset",
            "task": recipe.demonstrations,
            "episodes": episodes,
            "manner": recipe.manner,
            "image_size": size.image_size,
            "render_profile": size.render_profile,
            "video": size.video,
        },
        result="dataset",
    )
    tasks = tuple(task.name for task in tasks_named(recipe.demonstrations))
    return Demonstrations(stage, f"{stage.path}/dataset", tasks, episodes)


def _segment(cell: Cell, size: Size, recorded: Demonstrations, configs: Path) -> Demonstrations:
    """Plans a representation of all demonstrations, and the skills of those that are to be segmented."""
    recipe = cell.recipe
    file = configs.parent / size.segment
    source = {"repo_id": "local/demonstrations", "root": recorded.folder}
    trained = {f"representation.{k}": v for k, v in {**size.representation, **recipe.representation}.items()}
    represent = Stage(
        "represent",
        "lerobot-buds-segment",
        {"config_path": size.segment, **source, "work_dir": f"{OWN}/work", **trained, "representation_only": True},
        (recorded.stage,),
        (file,),
    )
    options: dict[str, Any] = {**source, "representation_path": f"{represent.path}/work/representation"}
    files: tuple[Path, ...] = ()
    if recipe.labels_from:
        options["labels_from"] = recipe.labels_from
    elif recipe.discovery:
        options["discovery"] = f"include {recipe.discovery}"
        files = (configs.parent / recipe.discovery,)
    options |= {f"discovery.{name}": value for name, value in recipe.segmentation.items()}
    numbers = recorded.numbers(recipe.segmented)
    if numbers is not None:
        options["episodes"] = numbers
    options |= {"output_repo_id": "local/skills", "output_root": f"{OWN}/dataset", "work_dir": f"{OWN}/work"}
    stage = Stage("segment", "lerobot-buds-segment", options, (recorded.stage, represent), files, result="dataset")
    return replace(recorded, stage=stage, folder=f"{stage.path}/dataset", tasks=recorded.only(recipe.segmented))


def _train(
    cell: Cell,
    size: Size,
    seed: int,
    data: Demonstrations,
    tasks: str,
    more: Mapping[str, Any],
    configs: Path,
    library: Stage | None = None,
) -> Stage:
    policy = {**size.policy_settings, **cell.recipe.policy, **more}
    steps = size.flat_steps if policy.get("skills") == "flat" else size.steps
    where = (
        {"root": data.folder} if size.in_memory else {"dataset.repo_id": "local/skills", "dataset.root": data.folder}
    )
    options: dict[str, Any] = {
        "policy": f"include {size.policy}",
        **{f"policy.{name}": value for name, value in policy.items()},
        **where,
        "output_dir": f"{OWN}/run",
        "steps": steps,
        "batch_size": size.batch_size,
        "seed": seed,
    }
    numbers = data.numbers(tasks)
    if numbers is not None:
        options["episodes" if size.in_memory else "dataset.episodes"] = numbers
    program = "scripts/train_in_memory.py" if size.in_memory else "lerobot-train"
    inputs = (data.stage,) if library is None else (data.stage, library)
    return Stage("train", program, options, inputs, (configs.parent / size.policy,))


def _checkpoint(training: Stage, size: Size) -> str:
    inside = "run/pretrained_model" if size.in_memory else "run/checkpoints/last/pretrained_model"
    return f"{training.path}/{inside}"


def _evaluate(
    size: Size, training: Stage, task: str, trials: int, limit: int | None, judge: Demonstrations | None
) -> Stage:
    options: dict[str, Any] = {
        "policy_path": _checkpoint(training, size),
        "env.type": "robosuite",
        "env.task": task,
        "env.image_size": size.image_size,
        "env.render_profile": size.render_profile,
        "output_dir": f"{OWN}/rollouts",
        "seed": FIRST_EVALUATION_SEED,
        "batch_size": size.at_once,
        "video": False,
    }
    if limit is not None:
        options["env.episode_length"] = limit
    inputs: tuple[Stage, ...] = (training,)
    if judge is not None:
        options["dataset_root"] = judge.folder
        inputs = (training, judge.stage)
    return Stage("evaluate", "lerobot-buds-rollout", options, inputs, amount={"episodes": trials})


def _text(value: Any) -> str:
    """Writes an option as draccus reads it."""
    return value if isinstance(value, str) else json.dumps(value)
