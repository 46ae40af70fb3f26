"""Results of cells: one small JSON file a cell and training seed, with the outcome of every trial."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from pathlib import Path
from statistics import mean, stdev
from typing import Any, Self

import numpy as np
from scipy.stats import binomtest

from lerobot_buds.core import ACTION, DatasetError, read_json, refuse_newer, write_json
from lerobot_buds.data import read_table
from lerobot_buds.evaluation import RolloutRecord, SuccessRate, failures_of, success_rate
from lerobot_buds.segmentation import SegmentationRecord

from .running import Workplace
from .stages import Run, Stage

SCHEMA_VERSION = 1
"""Raised whenever the meaning of a result changes; newer ones are refused."""


@dataclass(frozen=True)
class Trial:
    """One evaluation episode.

    Attributes:
        task: Name of the task.
        seed: Seed of the episode.
        success: The goal was reached.
        steps: Control steps that it took.
        stages: Control steps before each stage of the task was done; None where it never was.
        switches: How often the skill changed.
        failure: Class of the failure where failures are judged, see `insight.failure_of`.
    """

    task: str
    seed: int
    success: bool
    steps: int
    stages: tuple[int | None, ...]
    switches: int
    failure: str | None = None


@dataclass(frozen=True)
class CellResult:
    """What one training of one cell came to.

    Attributes:
        experiment: Name of the experiment.
        size: Name of the size.
        row: Name of the row.
        method: Name of the column.
        seed: Seed of the training.
        trials: All trials.
        steps: Training steps.
        seconds: Wall time of every stage, by its kind; those that serve several cells count in each.
        machine: Cores and GPU of the training.
        commit: Commit of this project that trained it.
        versions: Versions of what it was trained with.
        data: Hash of the demonstrations' actions.
        labels: Hash of the segmentation's labels; None where there is none.
        segmentation: Number of skills, and agreement with the true stages where they are known; None likewise.
    """

    experiment: str
    size: str
    row: str
    method: str
    seed: int
    trials: tuple[Trial, ...]
    steps: int
    seconds: dict[str, float]
    machine: str
    commit: str | None
    versions: dict[str, str]
    data: str
    labels: str | None = None
    segmentation: dict[str, Any] | None = None
    schema_version: int = field(default=SCHEMA_VERSION)

    @property
    def rate(self) -> SuccessRate:
        """How often it succeeded."""
        return success_rate(sum(trial.success for trial in self.trials), len(self.trials))

    @classmethod
    def read(cls, path: Path) -> Self:
        """Reads a result.

        Raises:
            DatasetError: It is damaged, or of a newer version than this package knows.
        """
        try:
            content = read_json(path)
            refuse_newer(path, content["schema_version"], SCHEMA_VERSION, "the next version", DatasetError)
            trials = tuple(Trial(**{**t, "stages": tuple(t["stages"])}) for t in content.pop("trials"))
            return cls(trials=trials, **content)
        except (KeyError, TypeError, ValueError) as error:
            raise DatasetError(f"{path} is damaged ({type(error).__name__}: {error}).") from error

    def write(self, path: Path) -> None:
        """Writes the result, atomically."""
        write_json(path, asdict(self))


def result_path(folder: Path, run: Run) -> Path:
    """Where a result belongs, below the folder of all results."""
    return folder / run.cell.experiment / run.size.name / f"{run.cell.name}.{run.seed}.json"


def collect_result(run: Run, workplace: Workplace) -> CellResult:
    """Puts the result of a cell together, all of whose stages are done."""
    training = workplace.state(run.training)
    found = None
    if run.segmentation is not None:
        found = SegmentationRecord.read(workplace.folder(run.segmentation) / "dataset")
    recorded = next(stage for stage in run.stages if stage.kind == "collect")
    seconds: dict[str, float] = {}
    for stage in run.stages:
        seconds[stage.kind] = round(seconds.get(stage.kind, 0.0) + workplace.state(stage)["seconds"], 1)
    return CellResult(
        experiment=run.cell.experiment,
        size=run.size.name,
        row=run.cell.row,
        method=run.cell.method,
        seed=run.seed,
        trials=tuple(trial for stage in run.evaluations for trial in _trials(stage, workplace)),
        steps=int(run.training.options["steps"]),
        seconds=seconds,
        machine=training["machine"],
        commit=training["commit"],
        versions=training["versions"],
        data=_actions_hash(workplace.folder(recorded) / "dataset"),
        labels=None if found is None else found.labels_hash,
        segmentation=None if found is None else {"n_skills": found.n_skills, "agreement": found.agreement},
    )


def _trials(stage: Stage, workplace: Workplace) -> list[Trial]:
    """Reads all trials that were run; episodes that the simulator lost are none."""
    record = RolloutRecord.read(workplace.folder(stage) / "rollouts")
    return [
        Trial(record.task, e.seed, e.success, e.length, e.stage_steps, e.switches, failure)
        for e, failure in zip(record.episodes, failures_of(record), strict=True)
        if not e.error
    ]


def _actions_hash(root: Path) -> str:
    actions = read_table(root, [ACTION]).columns[ACTION]
    return sha256(np.ascontiguousarray(actions, dtype=np.float32).tobytes()).hexdigest()


@dataclass(frozen=True)
class Pooled:
    """All trainings of one cell.

    Attributes:
        results: One a training.
    """

    results: tuple[CellResult, ...]

    @property
    def rate(self) -> SuccessRate:
        """Success over all trials of all trainings."""
        outcomes = [trial.success for result in self.results for trial in result.trials]
        return success_rate(sum(outcomes), len(outcomes))

    @property
    def mean(self) -> float:
        """Mean over the trainings of their success rates (%)."""
        return 100 * mean(result.rate.rate for result in self.results)

    @property
    def spread(self) -> float | None:
        """Sample standard deviation of the trainings' success rates (%); None with a single one."""
        return 100 * stdev(result.rate.rate for result in self.results) if len(self.results) > 1 else None

    @property
    def seeds(self) -> list[int]:
        """Seeds of the trainings."""
        return [result.seed for result in self.results]


@dataclass(frozen=True)
class Paired:
    """Two methods on the same episodes.

    Attributes:
        first_alone: Episodes in which only the first succeeded.
        second_alone: Those in which only the second did.
        episodes: All that both ran.
    """

    first_alone: int
    second_alone: int
    episodes: int

    def __add__(self, other: "Paired") -> "Paired":
        """Counts both comparisons together."""
        return Paired(
            self.first_alone + other.first_alone,
            self.second_alone + other.second_alone,
            self.episodes + other.episodes,
        )

    @property
    def p_value(self) -> float:
        """Chance of a difference as large if both were equally good: McNemar's exact test, two-sided."""
        discordant = self.first_alone + self.second_alone
        return float(binomtest(self.first_alone, discordant).pvalue) if discordant else 1.0


def paired(first: Pooled, second: Pooled) -> Paired:
    """Compares two methods on the trials that both ran, by training seed, task and seed of the trial."""
    a, b = (_outcomes(pooled.results) for pooled in (first, second))
    both = a.keys() & b.keys()
    return Paired(sum(a[k] and not b[k] for k in both), sum(b[k] and not a[k] for k in both), len(both))


def _outcomes(results: Sequence[CellResult]) -> dict[tuple[int, str, int], bool]:
    return {(r.seed, trial.task, trial.seed): trial.success for r in results for trial in r.trials}
