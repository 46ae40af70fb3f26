"""What is kept of rollouts: skills, decisions and progress of every episode, in one versioned JSON file.

The file grows batch by batch and is always whole, so that an interrupted run can go on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import (
    DISTRIBUTION,
    ConfigError,
    DatasetError,
    IntArray,
    Segment,
    labels_of,
    read_json,
    refuse_newer,
    write_json,
)
from lerobot_buds.envs import Task

SCHEMA_VERSION = 1
"""Raised whenever the record's meaning changes; older records are read, newer ones refused."""

RECORD_FILE = "rollouts.json"


class StageProgress:
    """Keeps when each stage of a task was first done.

    A stage is done when what it aims at first holds. Where that holds at the start already, as the stove is off before
    it has been on, it is done when it holds after all that the stage needs was done.

    Args:
        task: The task.

    Attributes:
        steps: Control steps before each stage was done, None while it is not.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._at_start: NDArray[np.bool_] | None = None
        self.steps: list[int | None] = [None] * len(task.stages)

    def update(self, holds: NDArray[np.bool_], step: int) -> None:
        """Notes what holds now; the first time, at the start.

        Args:
            holds: ``(S,)`` bool, the environment's ``stages_done``.
            step: Control steps so far.
        """
        if self._at_start is None:
            self._at_start = holds.copy()
        telling = set(np.flatnonzero(holds & ~self._at_start).tolist())
        # One stage may be all that another one waited for.
        while new := [n for n in np.flatnonzero(holds) if self.steps[n] is None and n in telling.union(self.possible)]:
            for number in new:
                self.steps[number] = step

    @property
    def possible(self) -> list[int]:
        """Numbers of the stages that may come next; several where the task leaves a choice, none after the last."""
        return self._task.possible_stages([number for number, step in enumerate(self.steps) if step is not None])


@dataclass(frozen=True)
class Decision:
    """One decision of an episode.

    Attributes:
        step: Control step from which it holds.
        proposed: Skill that the meta controller chose.
        skill: Skill that was done.
        foreign: Whether the nearest demonstrations do not use that skill there; None where none were asked.
    """

    step: int
    proposed: int
    skill: int
    foreign: bool | None


@dataclass(frozen=True)
class Episode:
    """One episode.

    Attributes:
        seed: Seed of the environment and of the meta controller's noise.
        success: The goal was reached.
        error: Empty, or why the simulator lost the episode, which then says nothing about the policy.
        skills: Half-open segments of the skill in force, over all T control steps.
        decisions: All decisions, in time order.
        stage_steps: Control steps before each stage of the task was first done; None where it never was.
    """

    seed: int
    success: bool
    error: str
    skills: tuple[Segment, ...]
    decisions: tuple[Decision, ...]
    stage_steps: tuple[int | None, ...]

    @property
    def length(self) -> int:
        """Number of control steps T."""
        return self.skills[-1].end if self.skills else 0

    @property
    def labels(self) -> IntArray:
        """Skill in force at every control step, ``(T,)`` int64."""
        return labels_of(list(self.skills))

    @property
    def switches(self) -> int:
        """How often the skill changed."""
        return max(0, len(self.skills) - 1)

    @property
    def last_progress(self) -> int:
        """Control steps before the stage that was done last; 0 where none was."""
        return max((step for step in self.stage_steps if step is not None), default=0)


@dataclass(frozen=True)
class RolloutRecord:
    """All episodes of one checkpoint in one task under the same settings.

    Attributes:
        settings: All that decides what happens in an episode of a given seed, as plain data.
        task: Name of the task.
        stages: Names of its stages.
        fps: Control steps per second.
        n_skills: Number of skills of the policy.
        period: Control steps for which a decision holds.
        episodes: In the order of their seeds.
    """

    settings: Mapping[str, Any]
    task: str
    stages: tuple[str, ...]
    fps: float
    n_skills: int
    period: int
    episodes: tuple[Episode, ...] = ()
    schema_version: int = SCHEMA_VERSION
    package_version: str = field(default_factory=lambda: version(DISTRIBUTION))

    def with_episodes(self, new: Sequence[Episode]) -> Self:
        """Adds episodes; one of the same seed as an earlier one takes its place."""
        by_seed = {episode.seed: episode for episode in (*self.episodes, *new)}
        return replace(self, episodes=tuple(by_seed[seed] for seed in sorted(by_seed)))

    @property
    def finished_seeds(self) -> set[int]:
        """Seeds that need not be run again: all but those of episodes that were lost to an error."""
        return {episode.seed for episode in self.episodes if not episode.error}

    def write(self, folder: Path, **derived: Any) -> None:
        """Writes the record as ``rollouts.json``, atomically.

        Args:
            folder: Created where missing.
            **derived: Plain data that follows from the record, for readers; it is not read back.
        """
        write_json(folder / RECORD_FILE, asdict(self) | derived)

    def resumed(self, folder: Path) -> Self:
        """Takes over the episodes that an earlier run of the same settings left in a folder.

        Raises:
            ConfigError: The folder holds rollouts of other settings; each that differs is named.
            DatasetError: Its record is damaged, or of a newer version than this package knows.
        """
        path = folder / RECORD_FILE
        if not path.exists():
            return self
        earlier = type(self).read(folder)
        differing = [
            f"{name}={earlier.settings.get(name)!r} (now {self.settings.get(name)!r})"
            for name in sorted({*earlier.settings, *self.settings})
            if earlier.settings.get(name) != self.settings.get(name)
        ]
        if differing:
            raise ConfigError(
                f"{path} holds rollouts of other settings: {', '.join(differing)}. Choose another output_dir, or "
                "remove that one."
            )
        return self.with_episodes(earlier.episodes)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Reads a record.

        Raises:
            DatasetError: It is missing, damaged, or of a newer version than this package knows.
        """
        path = folder / RECORD_FILE
        try:
            content = read_json(path)
            refuse_newer(path, content["schema_version"], SCHEMA_VERSION, content.get("package_version"), DatasetError)
            return cls(
                settings=content["settings"],
                task=content["task"],
                stages=tuple(content["stages"]),
                fps=content["fps"],
                n_skills=content["n_skills"],
                period=content["period"],
                episodes=tuple(_episode(episode) for episode in content["episodes"]),
            )
        except FileNotFoundError as error:
            raise DatasetError(f"{path} does not exist: there are no rollouts in {folder}.") from error
        except (KeyError, TypeError, ValueError) as error:
            raise DatasetError(
                f"{path} is damaged ({type(error).__name__}: {error}). Remove it to run its episodes again."
            ) from error


def _episode(content: Mapping[str, Any]) -> Episode:
    return Episode(
        content["seed"],
        content["success"],
        content["error"],
        tuple(Segment(*segment) for segment in content["skills"]),
        tuple(Decision(**decision) for decision in content["decisions"]),
        tuple(content["stage_steps"]),
    )
