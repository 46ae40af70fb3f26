"""Presses keys that LeRobot's commands listen to: "next", "record again", "stop", and those of its corrections.

LeRobot reads them from the X display by pynput where it can, and else from the terminal, if standard input is one. For
the latter a pseudo-terminal takes the place of standard input while a robot is connected: keys typed in the real
terminal are passed on, and the robot, or a page in a browser, can type, too. So it works without any terminal.
"""

import array
import atexit
import contextlib
import fcntl
import math
import os
import select
import termios
import threading
import time
import tty
from typing import Any

from lerobot.utils import keyboard_input

from lerobot_buds.core import ConfigError, near_names

KEYS = {
    "next": ("n", "right"),
    "re-record": ("r", "left"),
    "stop": ("\x1b", "esc"),
    "pause": (" ", "space"),
    "correct": ("\t", "tab"),
}
"""What is pressed -> the byte of a terminal, and the name of the key on a keyboard, by LeRobot's default settings."""

_PATIENCE_S = 0.2
_TO_ACT_S = 0.01
"""What LeRobot's thread is given to act on a key that it has read; without, an episode would get a frame too many."""

_NEXT = (b"n", b"N", b"\x1b[C", b"\x1bOC")
_ONCE_S = 1.0
"""A user's "next" within this time of another counts once: LeRobot would end the episode that follows at once, empty,
and fail."""

_STDIN = 0


class Keys:
    """The keyboard that LeRobot reads in this process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._master: int | None = None
        self._real: int | None = None
        self._modes: Any = None
        self._forwarding: threading.Thread | None = None
        self._wake: tuple[int, int] | None = None
        self._last_next = -math.inf

    def open(self) -> None:
        """Takes the place of standard input where LeRobot will read it; may be called twice."""
        with self._lock:
            if _display_is_read() or self._master is not None:
                return
            self._master, slave = os.openpty()
            os.set_blocking(self._master, False)  # nobody may be reading
            with contextlib.suppress(OSError):  # standard input may be closed
                self._real = os.dup(_STDIN)
            if self._real is not None and _is_ours(self._real):
                # LeRobot keeps the modes that it finds, and gives them to whatever is standard input at its end.
                self._modes = termios.tcgetattr(self._real)
                termios.tcsetattr(slave, termios.TCSANOW, self._modes)
                tty.setcbreak(self._real, termios.TCSANOW)
                self._wake = os.pipe()
                self._forwarding = threading.Thread(target=self._forward, daemon=True)
                self._forwarding.start()
            os.dup2(slave, _STDIN)
            os.close(slave)
            atexit.register(self.close)

    def release(self) -> None:
        """Gives a real terminal back. Where there is none, LeRobot's listener still needs this one until it stops."""
        if self._modes is not None:
            self.close()

    def close(self) -> None:
        """Gives standard input back as it was; may be called twice."""
        with self._lock:
            if self._master is None:
                return
            if self._wake is not None and self._forwarding is not None and self._real is not None:
                os.write(self._wake[1], b"x")
                self._forwarding.join()
                termios.tcsetattr(self._real, termios.TCSADRAIN, self._modes)
                for end in self._wake:
                    os.close(end)
            if self._real is not None:
                os.dup2(self._real, _STDIN)
                os.close(self._real)
            os.close(self._master)
            self._master = self._real = self._modes = self._wake = self._forwarding = None
            self._last_next = -math.inf
            atexit.unregister(self.close)

    def press(self, name: str) -> bool:
        """Presses a key, and waits until it was read, for at most 0.2 s: whoever is slower will read it yet.

        Args:
            name: One of `KEYS`.

        Returns:
            Whether somebody listens.
        """
        byte, key = KEYS[name]
        if _display_is_read():
            return _press_on_display(key)
        with self._lock:
            if self._master is None or termios.tcgetattr(_STDIN)[3] & termios.ICANON:  # nobody reads single keys
                return False
            try:
                os.write(self._master, byte.encode())
            except BlockingIOError:  # full of what nobody reads
                return False
            if name == "next":
                self._last_next = time.monotonic()
            patience = time.monotonic() + _PATIENCE_S
            while _unread() and time.monotonic() < patience:
                time.sleep(0.001)
            time.sleep(_TO_ACT_S)
            return True

    def is_repeated(self) -> bool:
        """Tells whether a user's "next" is one too many, since there was one just now; it counts as one."""
        last, self._last_next = self._last_next, time.monotonic()
        return self._last_next - last < _ONCE_S

    def _forward(self) -> None:
        """Passes on what is typed in the real terminal."""
        assert self._real is not None and self._master is not None and self._wake is not None
        while True:
            ready, _, _ = select.select([self._real, self._wake[0]], [], [])
            if self._wake[0] in ready:
                return
            try:
                typed = os.read(self._real, 64)
            except OSError:  # the terminal was closed
                return
            if not typed:
                return
            if typed in _NEXT and self.is_repeated():
                continue
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, typed)


_keys = Keys()


def keyboard() -> Keys:
    """Returns the one keyboard of this process: it has one standard input."""
    return _keys


def press(name: str) -> bool:
    """Presses a key for a user of LeRobot's command in this process; a "next" within a second of another counts once.

    Args:
        name: One of `KEYS`.

    Returns:
        Whether somebody listens.

    Raises:
        ConfigError: There is no such key.
    """
    if name not in KEYS:
        raise ConfigError(f"There is no key {name!r}. {near_names(name, KEYS)}")
    return (name == "next" and _keys.is_repeated()) or _keys.press(name)


def _display_is_read() -> bool:
    """Tells whether LeRobot reads keys from the X display; by its own conditions."""
    return keyboard_input.pynput_can_capture() and keyboard_input.keyboard is not None


def _is_ours(fd: int) -> bool:
    """Tells whether this is a terminal and this process is not in its background, where reading would stop it."""
    if not os.isatty(fd):
        return False
    try:
        return os.tcgetpgrp(fd) == os.getpgrp()
    except OSError:  # a terminal that controls no process, or others
        return True


def _unread() -> int:
    count = array.array("i", [0])
    fcntl.ioctl(_STDIN, termios.FIONREAD, count)
    return count[0]


def _press_on_display(key: str) -> bool:
    from pynput.keyboard import Controller, Key

    Controller().tap(getattr(Key, key))
    return True
