"""LeRobot's own ``lerobot-teleoperate``, unmodified, in a display where xdotool types. See scripts/setup.sh."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from lerobot_buds.envs import ACTION_NAMES
from lerobot_buds.teleoperation.layout import PAPER_SPEED, SLOW

NO_DISPLAY = not (shutil.which("Xvfb") and shutil.which("xdotool"))
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(NO_DISPLAY, reason="no display here: sudo apt-get install xvfb xdotool"),
]

ROOT = Path(__file__).parents[2]
HAND = ["eef_x.pos", "eef_y.pos", "eef_z.pos"]
STARTS_S, ANSWERS_S = 120.0, 20.0
MOVES = {"w": (0, -1), "s": (0, 1), "a": (1, -1), "d": (1, 1), "i": (2, 1), "k": (2, -1)}
"""Key -> axis of the world and sign, as docs/teleoperation.md has them."""


@pytest.fixture
def display():
    """The name of a display that nobody sees."""
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", "64x64x24", "-nolisten", "tcp"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    yield f":{server.stdout.readline().strip()}"
    server.terminate()
    server.wait()


class Session:
    """A running ``lerobot-teleoperate``, the keyboard before it, and the trace of its robot."""

    def __init__(self, display, folder):
        self.trace, self.log = folder / "trace.jsonl", folder / "log.txt"
        environment = {
            name: value for name, value in os.environ.items() if name not in ("WAYLAND_DISPLAY", "XDG_SESSION_TYPE")
        }
        plugins = Path(__file__).parent / "plugins"
        self.environment = environment | {"DISPLAY": display, "PYTHONPATH": f"{ROOT}{os.pathsep}{plugins}"}
        options = {
            "robot.discover_packages_path": "lerobot_robot_traced",
            "robot.type": "traced",
            "robot.image_size": 32,
            "robot.render_profile": "fastest",
            "robot.trace": self.trace,
            "teleop.type": "robosuite_hand",
            "teleop.device": "keyboard",
            "fps": 20,
        }
        program = Path(sys.executable).with_name("lerobot-teleoperate")
        with self.log.open("w") as log:
            self.process = subprocess.Popen(
                [sys.executable, program, *(f"--{name}={value}" for name, value in options.items())],
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def type(self, *words):
        subprocess.run(["xdotool", *words], env=self.environment, check=True)

    def lines(self):
        return [json.loads(line) for line in self.trace.read_text().splitlines()] if self.trace.exists() else []

    def latest(self):
        """Where the hand is (m), and the last action."""
        observed, action = self.lines()[-1]
        return np.array([observed[name] for name in HAND]), [action[name] for name in ACTION_NAMES]

    def until(self, holds, patience=ANSWERS_S):
        deadline = time.monotonic() + patience
        while not holds():
            assert self.process.poll() is None and time.monotonic() < deadline, self.log.read_text()[-3000:]
            time.sleep(0.03)


@pytest.fixture
def session(display, tmp_path):
    running = Session(display, tmp_path)
    try:
        running.until(lambda: len(running.lines()) > 3, STARTS_S)
        yield running
    finally:
        running.process.send_signal(signal.SIGKILL)
        running.process.wait()


def check_moves(session):
    """Each key moves the hand in its direction while it is held, at the documented speed, and no longer."""
    for key, (axis, sign) in MOVES.items():
        began, _ = session.latest()
        session.type("keydown", key)
        session.until(lambda: sign * (session.latest()[0] - began)[axis] > 0.03)  # noqa: B023 (called at once)
        _, action = session.latest()
        expected = [0.0, 0.0, 0.0, -1.0]
        expected[axis] = sign * PAPER_SPEED
        assert action == expected, key
        session.type("keyup", key)
        session.until(lambda: session.latest()[1] == [0.0, 0.0, 0.0, -1.0])
        time.sleep(0.3)
        moved = session.latest()[0] - began
        assert np.abs(np.delete(moved, axis)).max() < 0.02, key


def test_keys_move_the_hand_as_documented(session):
    check_moves(session)
    session.type("keydown", "shift", "keydown", "d")
    session.until(lambda: session.latest()[1] == [0.0, PAPER_SPEED * SLOW, 0.0, -1.0])
    session.type("keyup", "shift", "keyup", "d")  # what was pressed under shift is let go without it
    session.until(lambda: session.latest()[1] == [0.0, 0.0, 0.0, -1.0])
    session.type("key", "--delay", "200", "j")
    session.until(lambda: session.latest()[1][3] == 1.0)
    session.type("key", "Right", "Left", "Up", "space", "n")  # LeRobot's
    time.sleep(0.3)
    assert session.latest()[1] == [0.0, 0.0, 0.0, 1.0]
    session.type("key", "--delay", "200", "l")
    session.until(lambda: session.latest()[1][3] == -1.0)
    session.type("key", "Escape")
    assert session.process.wait(ANSWERS_S) == 0, session.log.read_text()[-3000:]
    assert "Traceback" not in session.log.read_text()
