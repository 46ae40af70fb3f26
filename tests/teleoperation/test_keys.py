"""Keys reach LeRobot's listener, from robot, page and terminal, and the terminal is given back as it was."""

import os
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest
from lerobot.utils.keyboard_input import init_keyboard_listener

from lerobot_buds.core import ConfigError
from lerobot_buds.teleoperation.keys import KEYS, keyboard, press

QUIET = {"exit_early": False, "rerecord_episode": False, "stop_recording": False}


@pytest.fixture
def listening(stdin):
    """The events of LeRobot's listener, which hears what is pressed."""
    keyboard().open()
    listener, events = init_keyboard_listener()
    assert listener is not None
    yield events
    keyboard().release()
    listener.stop()


@pytest.fixture
def terminal(monkeypatch):
    """A terminal as standard input: the end at which a user types."""
    user, end = os.openpty()
    former = os.dup(0)
    os.dup2(end, 0)
    yield user
    os.dup2(former, 0)
    for fd in (user, end, former):
        os.close(fd)


def eventually(condition):
    """Waits until LeRobot's thread has done it, or returns False after two seconds."""
    patience = time.monotonic() + 2
    while not (met := condition()) and time.monotonic() < patience:
        time.sleep(0.005)
    return met


@pytest.mark.parametrize(
    ("name", "event"),
    [("next", "exit_early"), ("re-record", "rerecord_episode"), ("stop", "stop_recording")],
)
def test_keys_are_heard_without_a_terminal(listening, name, event):
    assert keyboard().press(name)
    assert eventually(lambda: listening[event])


def test_nobody_listens_before_lerobot_does(stdin):
    assert not press("next")
    keyboard().open()
    assert not press("stop")


def test_a_users_next_right_after_another_counts_once(listening):
    keyboard().press("next")
    assert eventually(lambda: listening["exit_early"])
    listening["exit_early"] = False
    assert press("next")
    press("pause")  # read after whatever came before
    time.sleep(0.05)
    assert listening == QUIET


def test_an_unknown_key_is_refused(stdin):
    with pytest.raises(ConfigError, match=r"no key 'nxt'.*'next'"):
        press("nxt")
    assert set(KEYS) == {"next", "re-record", "stop", "pause", "correct"}


def test_a_terminal_is_read_and_given_back(terminal, stdin):
    before, name = termios.tcgetattr(0), os.ttyname(0)
    keyboard().open()
    assert os.ttyname(0) != name and sys.stdin.isatty()
    listener, events = init_keyboard_listener()
    os.write(terminal, b"r")
    assert eventually(lambda: events["rerecord_episode"])
    os.write(terminal, b"\x1b[C")
    assert eventually(lambda: events["exit_early"])
    events["exit_early"] = False
    os.write(terminal, b"n")  # one too many
    os.write(terminal, b"q")
    assert eventually(lambda: events["stop_recording"])
    keyboard().release()
    assert os.ttyname(0) == name
    listener.stop()  # LeRobot does this last
    assert termios.tcgetattr(0) == before


def test_it_opens_again_after_a_recording(listening):
    keyboard().close()
    assert not os.isatty(0)
    keyboard().open()
    assert os.isatty(0)


@pytest.fixture
def display():
    """An X display of its own."""
    read, write = os.pipe()
    server = subprocess.Popen(["Xvfb", "-displayfd", str(write), "-nolisten", "tcp"], pass_fds=[write])
    os.close(write)
    with os.fdopen(read) as told:
        number = told.readline().strip()
    yield f":{number}"
    server.terminate()
    server.wait()


def test_keys_are_pressed_on_a_display_where_lerobot_reads_it(display):
    program = Path(__file__).with_name("press_on_display.py")
    environment = {**os.environ, "DISPLAY": display, "XDG_SESSION_TYPE": "x11"}
    environment.pop("WAYLAND_DISPLAY", None)
    done = subprocess.run(
        [sys.executable, program],
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert "HEARD ['exit_early', 'rerecord_episode', 'stop_recording']" in done.stdout, done.stderr
