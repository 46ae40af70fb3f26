"""Runs LeRobot's own commands, unmodified, in this process: on the simulated robot, by a scripted teleoperator."""

import importlib
import logging
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from lerobot_buds.teleoperation.config_robosuite_hand import RobosuiteHandConfig
from lerobot_buds.teleoperation.keys import keyboard
from lerobot_buds.teleoperation.robosuite_hand import RobosuiteHand

SMALL = {"image_size": 32, "render_profile": "fastest", "new_scene_s": 0}


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> type:
    """The teleoperator's class, to interrupt it by `before`."""
    monkeypatch.syspath_prepend(Path(__file__).parent / "plugins")
    teleoperator = importlib.import_module("lerobot_teleoperator_scripted").Scripted
    monkeypatch.setattr(teleoperator, "before", None)
    return teleoperator


@pytest.fixture
def said() -> Iterator[list[str]]:
    """What the robot says in the log; LeRobot's commands remove pytest's own listener."""

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            messages.append(record.getMessage())

    messages: list[str] = []
    logger, listener = logging.getLogger("lerobot_buds.teleoperation"), Listener()
    level = logger.level
    logger.addHandler(listener)
    logger.setLevel(logging.INFO)
    yield messages
    logger.removeHandler(listener)
    logger.setLevel(level)


@pytest.fixture
def stdin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Standard input as a command finds it, which is no terminal here; and no keys from a display."""
    monkeypatch.setattr("lerobot.utils.keyboard_input.pynput_can_capture", lambda: False)
    with open(0, closefd=False) as real:
        monkeypatch.setattr(sys, "stdin", real)
        yield
    keyboard().close()


def briefly(seconds: float) -> None:
    """Waits hardly at all, instead of a control step; but long enough for LeRobot's thread to act on a key."""
    was_pressed = time.monotonic() - keyboard()._last_next < 0.1
    time.sleep(0.2 if was_pressed else min(seconds, 0.001))


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, stdin: None) -> Iterator[Callable[..., None]]:
    """Runs a console script's `main` with options, hardly waiting between steps; gives log and signals back."""

    def run(module: str, **options: Any) -> None:
        script = importlib.import_module(f"lerobot.scripts.{module}")
        monkeypatch.setattr(script, "precise_sleep", briefly, raising=False)
        arguments = [f"--{key}={value}" for key, value in options.items()]
        monkeypatch.setattr(sys, "argv", [module, *arguments])
        logger = logging.getLogger()
        level, handlers = logger.level, list(logger.handlers)
        try:
            script.main()
        finally:
            logger.setLevel(level)
            logger.handlers[:] = handlers

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
    former = {number: signal.getsignal(number) for number in numbers}
    for number in numbers:  # as in a terminal: what runs in the background or under nohup ignores some of them
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    yield run
    for number, handler in former.items():
        signal.signal(number, handler)


@pytest.fixture
def record(run: Callable[..., None], scripted: type, tmp_path: Path) -> Callable[..., Path]:
    """Records demonstrations of a task into a new folder with ``lerobot-record``."""

    def record(task: str, seeds: list[int], text: str = "Do it", **options: Any) -> Path:
        root = tmp_path / "recorded"
        settings = {
            "robot.type": "robosuite_sim",
            "robot.task": task,
            "robot.seed": seeds[0],
            "robot.dataset_root": root,
            **{f"robot.{key}": value for key, value in SMALL.items()},
            "teleop.type": "scripted",
            "teleop.task": task,
            "teleop.seeds": seeds,
            "dataset.repo_id": "tests/recorded",
            "dataset.root": root,
            "dataset.single_task": text,
            "dataset.fps": 20,
            "dataset.num_episodes": len(seeds),
            "dataset.episode_time_s": 300,
            "dataset.reset_time_s": 300,
            "dataset.video": "false",
            "dataset.push_to_hub": "false",
            "play_sounds": "false",
        }
        run("lerobot_record", **{**settings, **options})
        return root

    return record


@pytest.fixture
def hand(tmp_path):
    """Makes a `RobosuiteHand` from settings, and closes it in the end."""
    made = []

    def make(**settings):
        made.append(RobosuiteHand(RobosuiteHandConfig(calibration_dir=tmp_path, **settings)))
        return made[-1]

    yield make
    for each in made:
        each.disconnect()
