"""Reproduces the paper's tables, or rows of them, at a size that fits the machine.

    python scripts/reproduce.py --experiments='[table1]' --size=cpu

Every stage runs one public command, once, in a folder that is named by all that decides its result. It may be
interrupted and run again at any time. Results are written to docs/results, one file a cell and training seed, and
docs/results.md is made from them.
"""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from pathlib import Path
from signal import SIGTERM, signal
from typing import Any

from lerobot_buds.cli.running import parse, run
from lerobot_buds.core import ConfigError, near_names
from lerobot_buds.experiments import (
    Cell,
    Experiment,
    Reproduction,
    Size,
    Workplace,
    local_launcher,
    stop_commands,
    submitit_launcher,
    write_report,
)

PROJECT = Path(__file__).parents[1]
EXPERIMENTS = PROJECT / "configs/experiments"


@dataclass
class ReproduceConfig:
    """Settings of a reproduction."""

    experiments: list[str] = field(default_factory=list)
    """Names of the experiments, files of ``configs/experiments``; all where none is given."""

    rows: str = "*"
    """Pattern of the rows to run."""

    methods: str = "*"
    """Pattern of the methods to run."""

    size: str = "cpu"
    """Name of a file of ``configs/experiments/sizes``."""

    seeds: list[int] = field(default_factory=list)
    """Seeds of the trainings; those of the size where none is given."""

    trials: int | None = None
    """Most trials of one training; None for what the size says. More are added to those that were run."""

    output_dir: Path = Path("outputs/reproduction")
    """Folder of all stages; with several machines, on a disk that they share."""

    results: Path = PROJECT / "docs/results"
    """Folder of the results."""

    jobs: int = 1
    """Stages at a time; each takes a core."""

    processes: int = 1
    """Processes that share a training of ``lerobot-train``, by ``accelerate launch``: one a GPU."""

    max_minutes: float | None = None
    """Stops after this time; what was begun goes on the next time."""

    dry_run: bool = False
    """Only lists what would be run, and how long it took when it was run before."""

    report_only: bool = False
    """Runs nothing: writes the results of what is done, and makes the report of all results that are there."""

    launcher: str = "local"
    """Where stages run: ``local``, or through ``submitit`` (SLURM, or its local processes)."""

    cluster: str | None = None
    """Of submitit: ``slurm`` or ``local``; None for what is there."""

    submitit: dict[str, Any] = field(default_factory=dict)
    """Parameters of submitit's executor: ``timeout_min``, ``slurm_partition``, ``gpus_per_node`` and others."""


def reproduce(config: ReproduceConfig) -> int:
    """Runs what is asked for; returns the status of the command."""
    chosen = [Experiment.read(file) for file in _files(EXPERIMENTS, config.experiments)]
    size = Size.read(_files(EXPERIMENTS / "sizes", [config.size])[0])
    size = size if config.trials is None else replace(size, most_trials=config.trials)
    cells = [cell for experiment in chosen for cell in experiment.cells if _is_wanted(cell, config)]
    if not cells:
        raise ConfigError(f"No cell has a row like {config.rows!r} and a method like {config.methods!r}.")
    workplace = Workplace(config.output_dir, PROJECT, config.processes)
    results = config.results if size.reported else config.output_dir / "results"
    reproduction = Reproduction.of(cells, size, config.seeds, workplace, results)
    if config.dry_run:
        print(reproduction.table(), end="")
        return 0
    errors = []
    if config.report_only:
        reproduction.write_results()
    else:
        with _stopping_commands():
            errors = reproduction.run(_launcher(config, workplace), config.jobs, config.max_minutes)
        for error in errors:
            print(f"error: {error}", file=sys.stderr)
    if size.reported:
        print(f"The report is {write_report(EXPERIMENTS, config.results)}.")
    left = sum(not workplace.is_done(stage) for stage in reproduction.stages)
    print(f"{len(reproduction.stages) - left} of {len(reproduction.stages)} stages are done.")
    return 1 if errors else 0


def _is_wanted(cell: Cell, config: ReproduceConfig) -> bool:
    return fnmatch(cell.row, config.rows) and fnmatch(cell.method, config.methods)


def _files(folder: Path, names: list[str]) -> list[Path]:
    known = {file.stem: file for file in sorted(folder.glob("*.yaml"))}
    for name in names:
        if name not in known:
            raise ConfigError(f"{folder} has no {name}.yaml. {near_names(name, known)}")
    return [known[name] for name in names] or list(known.values())


def _launcher(config: ReproduceConfig, workplace: Workplace) -> Any:
    if config.jobs < 1:
        raise ConfigError(f"jobs={config.jobs} must be at least 1.")
    if config.launcher == "local":
        return local_launcher(workplace, config.jobs)
    if config.launcher == "submitit":
        return submitit_launcher(workplace, config.submitit, config.cluster)
    raise ConfigError(f"launcher={config.launcher!r} is unknown. {near_names(config.launcher, ('local', 'submitit'))}")


@contextmanager
def _stopping_commands() -> Iterator[None]:
    """Stops the commands that run when this process is stopped."""
    signal(SIGTERM, lambda *_: sys.exit(143))
    try:
        yield
    finally:
        stop_commands()


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
    config = parse(ReproduceConfig)
    sys.exit(run(lambda: reproduce(config)))
