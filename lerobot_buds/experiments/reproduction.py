"""Runs experiments: plans their stages, runs what is not done, and writes each result as soon as it is there."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from .experiment import Cell, Size
from .results import CellResult, collect_result, result_path
from .running import DONE_FILE, Launch, StageError, Workplace, run_stages
from .stages import Run, Stage, plan


@dataclass(frozen=True)
class Reproduction:
    """Cells that are to be run at one size.

    Attributes:
        runs: Each with its stages.
        workplace: Where they run.
        results: Folder of the results.
    """

    runs: tuple[Run, ...]
    workplace: Workplace
    results: Path

    @classmethod
    def of(
        cls, cells: Iterable[Cell], size: Size, seeds: Sequence[int], workplace: Workplace, results: Path
    ) -> "Reproduction":
        """Plans all cells with every seed, the first seed of all cells first."""
        configs, cells = workplace.project / "configs", list(cells)
        runs = tuple(plan(cell, size, seed, configs) for seed in seeds or size.seeds for cell in cells)
        return cls(runs, workplace, results)

    @property
    def stages(self) -> list[Stage]:
        """Every stage once, in an order in which they can be run."""
        return list({stage.key: stage for run in self.runs for stage in run.stages}.values())

    def run(self, launch: Launch, jobs: int, max_minutes: float | None) -> list[StageError]:
        """Runs what is not done.

        Args:
            launch: Starts a stage.
            jobs: Stages at a time.
            max_minutes: Time after which those that run are stopped, to go on another time.

        Returns:
            What failed.
        """
        deadline = None if max_minutes is None else time.monotonic() + 60 * max_minutes
        stages = self.stages
        self.write_results()
        done = sum(self.workplace.is_done(stage) for stage in stages)
        with tqdm(total=len(stages), initial=done, desc="stages", unit="stage", dynamic_ncols=True) as bar:
            return run_stages(stages, self.workplace, launch, jobs, deadline, self._watch(bar))

    def write_results(self) -> list[Path]:
        """Writes the results of all cells whose stages are done, and have no such result yet.

        Returns:
            All results that are there.
        """
        paths = []
        for run in self.runs:
            path = result_path(self.results, run)
            if all(self.workplace.is_done(stage) for stage in run.stages):
                if not path.exists() or path.stat().st_mtime < self._newest(run):
                    collect_result(run, self.workplace).write(path)
                paths.append(path)
        return paths

    def table(self) -> str:
        """Lists what a run would do, with the time that such stages took in the results that are there."""
        known = self._known_seconds()
        lines = [f"{'':<6}{'seconds':>8}  command\n"]
        left = 0.0
        for stage in self.stages:
            done = self.workplace.is_done(stage)
            seconds = self.workplace.state(stage).get("seconds") if done else known.get(stage.kind)
            left += 0.0 if done or seconds is None else seconds
            command = " ".join(stage.command(self.workplace.root))
            shown = "" if seconds is None else f"{seconds:.0f}"
            lines.append(f"{'done' if done else 'to do':<6}{shown:>8}  {command}\n")
        lines.append(f"Some {left / 60:.0f} min of one job to go, by what such stages took elsewhere.\n")
        return "".join(lines)

    def _known_seconds(self) -> dict[str, float]:
        """Mean seconds of every kind of stage, over the results of the same size."""
        seconds: dict[str, list[float]] = {}
        for size in {run.size.name for run in self.runs}:
            for path in self.results.glob(f"*/{size}/*.json"):
                for kind, value in CellResult.read(path).seconds.items():
                    seconds.setdefault(kind, []).append(value)
        return {kind: sum(values) / len(values) for kind, values in seconds.items()}

    def _newest(self, run: Run) -> float:
        return max((self.workplace.folder(stage) / DONE_FILE).stat().st_mtime for stage in run.stages)

    def _watch(self, bar: "tqdm[Any]") -> Callable[[Stage, bool], None]:
        def on_change(stage: Stage, done: bool) -> None:
            if not done:
                tqdm.write(f"started {' '.join(stage.command(self.workplace.root))}"[:400])
                return
            bar.update()
            for path in self.write_results():
                bar.set_postfix_str(path.name)

        return on_change
