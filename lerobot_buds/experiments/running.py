"""Runs stages: each once, several at a time, resumable after a kill, on this machine or through submitit."""

import logging
import os
import platform
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from lerobot_buds.core import DISTRIBUTION, BudsError, ConfigError, read_json, write_json

from .stages import Stage

logger = logging.getLogger(__name__)

DONE_FILE = "stage.json"
"""What a stage's folder holds once it is done, and how long it took up to now."""

LOG_FILE = "log.txt"
"""All that a stage printed."""

ONE_THREAD = {"OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1"}
"""Several jobs share the cores; everything is local, so that LeRobot need not ask the Hub."""

PACKAGES = (DISTRIBUTION, "lerobot", "torch", "robosuite", "mujoco", "numpy")


class StageError(BudsError):
    """A stage's command failed."""


@dataclass(frozen=True)
class Workplace:
    """Where stages run.

    Attributes:
        root: Folder of all stages.
        project: Folder of the checkout.
        processes: How many share a training of ``lerobot-train``, by ``accelerate launch``, each with its part of a
            batch.
        environment: Variables that commands get.
    """

    root: Path
    project: Path
    processes: int = 1
    environment: Mapping[str, str] = field(default_factory=lambda: dict(ONE_THREAD))

    def folder(self, stage: Stage) -> Path:
        """Folder of a stage."""
        return self.root / stage.key

    def state(self, stage: Stage) -> dict[str, Any]:
        """What is known of a stage: its seconds up to now, and its command once it is done."""
        file = self.folder(stage) / DONE_FILE
        return dict(read_json(file)) if file.exists() else {}

    def is_done(self, stage: Stage) -> bool:
        """Whether a stage has run to its end, with at least what is wanted of it."""
        done = self.state(stage).get("done")
        return done is not None and all(done.get(name, 0) >= amount for name, amount in stage.amount.items())

    def run(self, stage: Stage) -> None:
        """Runs a stage to its end, going on where an interrupted run was.

        Raises:
            StageError: The command failed; its output is in the stage's folder.
        """
        folder = self.folder(stage)
        folder.mkdir(parents=True, exist_ok=True)
        try:
            with FileLock(folder / ".lock", timeout=0):
                if not self.is_done(stage):
                    self._run(stage, folder)
        except Timeout as error:
            raise StageError(f"{folder} is being made by another process; wait for it, then run this again.") from error

    def _run(self, stage: Stage, folder: Path) -> None:
        command, before = self._resumed(stage, folder), self.state(stage).get("seconds", 0.0)
        known = {"kind": stage.kind, "command": command, **self._machine()}
        write_json(folder / DONE_FILE, {**self.state(stage), **known})
        began = time.monotonic()
        # Whole, if the runner was killed between the end of the command and its note of it.
        status = 0 if stage.result and (folder / stage.result).exists() else self._call(command, folder / LOG_FILE)
        state = {**self.state(stage), "seconds": round(before + time.monotonic() - began, 1)}
        if status == 0:
            state["done"] = dict(stage.amount)
        write_json(folder / DONE_FILE, state)
        if status != 0:
            raise StageError(f"{stage.kind} failed (status {status}); its output is in {folder / LOG_FILE}.")

    def _call(self, command: list[str], log_file: Path) -> int:
        with log_file.open("ab") as log:
            process = subprocess.Popen(
                self._words(command),
                cwd=self.project,
                env=os.environ | dict(self.environment),
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # an interrupt is for the runner, which passes it on
            )
        _RUNNING[process.pid] = process
        try:
            return process.wait()
        finally:
            del _RUNNING[process.pid]

    def _words(self, command: list[str]) -> list[str]:
        """Finds the program: of this very environment, whatever the PATH says, or a script of the checkout."""
        program, *options = command
        found = [sys.executable, program] if program.endswith(".py") else [_installed(program)]
        if program == "lerobot-train" and self.processes > 1:
            found = [_installed("accelerate"), "launch", f"--num_processes={self.processes}", *found]
            options = [self._share(option) for option in options]
        # Where the runner is killed, its commands end as well: run again, it would meet them at their work.
        tied = ["setpriv", "--pdeathsig", "KILL"] if shutil.which("setpriv") else []
        return [*tied, *found, *options]

    def _share(self, option: str) -> str:
        """Gives one process its part of a batch: LeRobot's batches are those of a process."""
        name, _, value = option.partition("=")
        if name != "--batch_size":
            return option
        if int(value) % self.processes:
            raise ConfigError(f"A batch of {value} cannot be shared by processes={self.processes}.")
        return f"{name}={int(value) // self.processes}"

    def _resumed(self, stage: Stage, folder: Path) -> list[str]:
        """Makes the command, from LeRobot's last checkpoint on if there is one."""
        if stage.program != "lerobot-train":
            return stage.command(self.root)
        last = folder / "run/checkpoints/last/pretrained_model/train_config.json"
        if last.exists():
            return ["lerobot-train", f"--config_path={last}", "--resume=true"]
        shutil.rmtree(folder / "run", ignore_errors=True)  # interrupted before the first checkpoint
        return stage.command(self.root)

    def _machine(self) -> dict[str, Any]:
        commit = subprocess.run(
            ["git", "describe", "--always", "--dirty"], cwd=self.project, capture_output=True, text=True, check=False
        )
        return {
            "commit": commit.stdout.strip() or None,
            "machine": _describe_machine(),
            "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
        }


def _installed(program: str) -> str:
    return str(Path(sys.executable).with_name(program))


_RUNNING: dict[int, subprocess.Popen[bytes]] = {}
"""Commands that run now, to be stopped with the runner."""


def stop_commands() -> None:
    """Interrupts all commands that run; they go on where they were when they are run again."""
    for process in list(_RUNNING.values()):
        process.terminate()


def _describe_machine() -> str:
    import torch

    gpu = f", {torch.cuda.get_device_name()}" if torch.cuda.is_available() else ""
    return f"{len(os.sched_getaffinity(0))} CPU cores{gpu}"


type Launch = Callable[[Stage], Future[None]]
"""Starts a stage."""


def run_stages(
    stages: Iterable[Stage],
    workplace: Workplace,
    launch: Launch,
    jobs: int,
    deadline: float | None,
    on_change: Callable[[Stage, bool], object],
) -> list[StageError]:
    """Runs all stages, each as soon as what it needs is done.

    Args:
        stages: The stages; the earlier first where there is a choice.
        workplace: Where they run.
        launch: Starts one.
        jobs: How many run at a time.
        deadline: Of `time.monotonic`; none is started behind it, and those that run are stopped.
        on_change: Called with a stage when it starts (False) and when it is done (True).

    Returns:
        What failed. Whatever does not need it is run all the same.
    """
    waiting = {stage.key: stage for stage in stages if not workplace.is_done(stage)}
    running: dict[Future[None], Stage] = {}
    errors: list[StageError] = []
    while waiting or running:
        ready = [s for s in waiting.values() if all(workplace.is_done(needed) for needed in s.inputs)]
        for stage in ready[: jobs - len(running)]:
            if deadline is None or time.monotonic() < deadline:
                running[launch(waiting.pop(stage.key))] = stage
                on_change(stage, False)
        if not running:
            break  # nothing can go on
        patience = None if deadline is None else max(0.0, deadline - time.monotonic())
        finished, _ = wait(running, patience, FIRST_COMPLETED)
        stopped = not finished
        if stopped:
            stop_commands()
            finished, _ = wait(running)
        for future in finished:
            stage, error = running.pop(future), future.exception()
            if error is None:
                on_change(stage, True)
            elif not isinstance(error, StageError):
                raise error
            elif not stopped:
                errors.append(error)
    return errors


def local_launcher(workplace: Workplace, jobs: int) -> Launch:
    """Runs stages on this machine, a thread for each command."""
    pool = ThreadPoolExecutor(jobs)
    return lambda stage: pool.submit(workplace.run, stage)


def submitit_launcher(workplace: Workplace, parameters: Mapping[str, Any], cluster: str | None) -> Launch:
    """Runs stages through submitit, on a SLURM cluster or as local processes; the root must lie on a shared disk.

    Args:
        workplace: Where they run.
        parameters: Of ``AutoExecutor.update_parameters``: ``timeout_min``, ``slurm_partition``, ``gpus_per_node``...
        cluster: ``slurm``, ``local``, or None for what is there.

    Raises:
        ConfigError: submitit is not installed.
    """
    try:
        import submitit
    except ImportError as error:
        raise ConfigError("launcher=submitit needs it: pip install 'lerobot_policy_buds[cluster]'.") from error
    executor = submitit.AutoExecutor(folder=workplace.root / "submitit", cluster=cluster)
    executor.update_parameters(**{"timeout_min": 24 * 60, **parameters})

    def launch(stage: Stage) -> Future[None]:
        job = executor.submit(workplace.run, stage)
        future: Future[None] = Future()

        def follow() -> None:
            error = job.exception()
            if error is None:
                future.set_result(None)
            else:
                future.set_exception(StageError(f"{stage.kind} failed in job {job.job_id}: {error}"))

        threading.Thread(target=follow, daemon=True).start()
        return future

    return launch
