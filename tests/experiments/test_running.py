"""Stages run once, in order, go on after a kill, and stop at a deadline; with commands that take no time."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from lerobot_buds.core import ConfigError, read_json
from lerobot_buds.experiments import Stage, StageError, Workplace, local_launcher, run_stages, submitit_launcher

pytestmark = pytest.mark.slow

PROGRAM = """\
import sys, time
from pathlib import Path
options = dict(word[2:].split("=", 1) for word in sys.argv[1:])
with Path(options["log"]).open("a") as log:
    log.write(options["name"] + "\\n")
for needed in options.get("needs", "").split():
    assert Path(needed).exists(), needed
time.sleep(float(options["seconds"]))
if options["name"] == "bad":
    sys.exit(3)
Path(options["out"]).write_text("done")
"""


@pytest.fixture
def workplace(tmp_path: Path) -> Workplace:
    (tmp_path / "project/scripts").mkdir(parents=True)
    (tmp_path / "project/scripts/work.py").write_text(PROGRAM)
    return Workplace(tmp_path / "stages", tmp_path / "project")


def make(workplace: Workplace, name: str, *needs: Stage, seconds: float = 0.0, **amount: int) -> Stage:
    options = {"name": name, "log": str(workplace.project / "log"), "out": "{own}/out", "seconds": seconds}
    options["needs"] = " ".join(f"{stage.path}/out" for stage in needs)
    return Stage("collect", "scripts/work.py", options, needs, amount=amount)


def ran(workplace: Workplace) -> list[str]:
    log = workplace.project / "log"
    return log.read_text().split() if log.exists() else []


def run(
    workplace: Workplace, stages: Sequence[Stage], jobs: int = 1, deadline: float | None = None
) -> list[StageError]:
    return run_stages(stages, workplace, local_launcher(workplace, jobs), jobs, deadline, lambda *_: None)


def test_each_stage_runs_once_behind_what_it_needs(workplace: Workplace) -> None:
    a = make(workplace, "a")
    b, c = make(workplace, "b", a), make(workplace, "c", a)
    d = make(workplace, "d", b, c)
    assert run(workplace, [d, c, b, a], jobs=2) == []
    assert ran(workplace)[0] == "a" and ran(workplace)[3] == "d" and sorted(ran(workplace)) == ["a", "b", "c", "d"]
    assert run(workplace, [a, b, c, d]) == [] and len(ran(workplace)) == 4
    state = workplace.state(a)
    assert state["done"] == {} and "seconds" in state and state["versions"]["torch"] and "cores" in state["machine"]


def test_jobs_run_side_by_side(workplace: Workplace) -> None:
    stages = [make(workplace, name, seconds=1.0) for name in "ab"]
    began = time.monotonic()
    run(workplace, stages, jobs=2)
    assert time.monotonic() - began < 1.9


def test_what_fails_stops_only_what_needs_it(workplace: Workplace) -> None:
    bad = make(workplace, "bad")
    behind, beside = make(workplace, "behind", bad), make(workplace, "beside")
    (error,) = run(workplace, [bad, behind, beside])
    assert "status 3" in str(error) and "log.txt" in str(error)
    assert sorted(ran(workplace)) == ["bad", "beside"]
    assert not workplace.is_done(bad) and workplace.is_done(beside)


def test_more_of_the_same_runs_again(workplace: Workplace) -> None:
    run(workplace, [make(workplace, "a", episodes=10)])
    assert workplace.is_done(make(workplace, "a", episodes=5))
    more = make(workplace, "a", episodes=20)
    assert not workplace.is_done(more)
    run(workplace, [more])
    assert ran(workplace) == ["a", "a"] and workplace.state(more)["done"] == {"episodes": 20}


def test_the_deadline_stops_what_runs(workplace: Workplace) -> None:
    slow, next_one = make(workplace, "slow", seconds=30), make(workplace, "next")
    assert run(workplace, [slow, next_one], deadline=time.monotonic() + 1) == []
    assert ran(workplace) == ["slow"] and not workplace.is_done(slow)
    assert workplace.state(slow)["seconds"] >= 0.5


def test_seconds_of_interrupted_runs_are_counted(workplace: Workplace) -> None:
    stage = make(workplace, "a", seconds=2)
    run(workplace, [stage], deadline=time.monotonic() + 1)
    run(workplace, [stage])
    assert workplace.state(stage)["seconds"] >= 2.5


def test_a_result_that_is_whole_is_not_made_again(workplace: Workplace) -> None:
    """The runner was killed between the end of the command and its note of it."""
    stage = replace(make(workplace, "a"), result="out")
    run(workplace, [stage])
    (workplace.folder(stage) / "stage.json").unlink()
    assert run(workplace, [stage]) == [] and ran(workplace) == ["a"] and workplace.is_done(stage)


def test_no_stage_is_made_by_two_at_once(workplace: Workplace) -> None:
    from filelock import FileLock

    stage = make(workplace, "a")
    folder = workplace.folder(stage)
    folder.mkdir(parents=True)
    with FileLock(folder / ".lock"):
        (error,) = run(workplace, [stage])
    assert "another process" in str(error) and ran(workplace) == []


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_commands_end_with_the_runner(workplace: Workplace, how: signal.Signals) -> None:
    script = (
        "import sys, signal\nfrom pathlib import Path\nfrom lerobot_buds.experiments import *\n"
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell's background jobs ignore it
        f"w = Workplace(Path({str(workplace.root)!r}), Path({str(workplace.project)!r}))\n"
        f"s = Stage('collect', 'scripts/work.py', {dict(make(workplace, 'slow', seconds=300).options)!r})\n"
        "try:\n    run_stages([s], w, local_launcher(w, 1), 1, None, lambda *_: None)\nfinally:\n    stop_commands()\n"
    )
    runner = subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.DEVNULL)
    while not ran(workplace):
        time.sleep(0.1)
        assert runner.poll() is None
    runner.send_signal(how)
    runner.wait(20)
    for _ in range(100):
        if not commands_of(workplace):
            break
        time.sleep(0.1)
    assert commands_of(workplace) == []


def commands_of(workplace: Workplace) -> list[int]:
    """Processes that work in the project's folder."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if process.joinpath("cwd").readlink() == workplace.project and int(process.name) != os.getpid():
                found.append(int(process.name))
        except OSError:
            continue
    return found


def test_processes_share_a_training(workplace: Workplace) -> None:
    shared = replace(workplace, processes=4)
    command = ["lerobot-train", "--batch_size=128", "--steps=5"]
    (*_, launcher, launch, processes, program), options = shared._words(command)[:-2], shared._words(command)[-2:]
    assert Path(launcher).name == "accelerate" and (launch, processes) == ("launch", "--num_processes=4")
    assert Path(program).name == "lerobot-train" and options == ["--batch_size=32", "--steps=5"]
    with pytest.raises(ConfigError, match="A batch of 30"):
        shared._words(["lerobot-train", "--batch_size=30"])


def test_stages_run_through_submitit(workplace: Workplace) -> None:
    a = make(workplace, "a")
    b, bad = make(workplace, "b", a), make(workplace, "bad")
    launch = submitit_launcher(workplace, {"timeout_min": 5}, "local")
    errors = run_stages([b, a, bad], workplace, launch, 2, None, lambda *_: None)
    assert workplace.is_done(a) and workplace.is_done(b)
    assert len(errors) == 1 and "failed in job" in str(errors[0])
    assert read_json(workplace.folder(b) / "stage.json")["done"] == {}
