"""An orderly end of a process that is told to end: as after Ctrl-C, whole episodes are kept.

By default SIGTERM, and SIGHUP of a terminal that is closed, end a process at once. Then LeRobot's tables, which get
their last bytes when a recording is finished, cannot be read.
"""

import signal
import threading
from types import FrameType

_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


class OrderlyEnd:
    """Turns signals into `SystemExit` where nobody deals with them: LeRobot's rollouts do, its recordings do not."""

    def __init__(self) -> None:
        self._taken: list[signal.Signals] = []

    def begin(self) -> None:
        """Deals with the signals from now on; does nothing outside the main thread."""
        if threading.current_thread() is threading.main_thread():
            self._taken = [number for number in _SIGNALS if signal.getsignal(number) == signal.SIG_DFL]
            for number in self._taken:
                signal.signal(number, self._end)

    def stop(self) -> None:
        """Gives the signals back; may be called twice."""
        for number in self._taken:
            if signal.getsignal(number) in (self._end, signal.SIG_IGN):
                signal.signal(number, signal.SIG_DFL)
        self._taken = []

    def _end(self, number: int, frame: FrameType | None) -> None:
        for taken in self._taken:
            signal.signal(taken, signal.SIG_IGN)  # a second one would interrupt the end
        raise SystemExit(128 + number)
