"""Which keys are held in the pages of a browser. What is not said again soon is let go: the page may be gone."""

import threading
import time
from collections.abc import Callable, Iterable, Set

FORGOTTEN_S = 0.5
"""How long a key stays held that its page says nothing more about (s). A page repeats what is held every 0.1 s."""

MOST_PAGES = 16
"""Pages that are remembered; the oldest one makes room."""


class HeldKeys:
    """Keys by page, each with the time at which it was said.

    Args:
        known: Names that mean something; others are dropped.
        clock: Tells the time (s).
    """

    def __init__(self, known: Set[str], clock: Callable[[], float] = time.monotonic) -> None:
        self._known, self._clock, self._lock = known, clock, threading.Lock()
        self._said: dict[str, tuple[int, float, frozenset[str]]] = {}

    def say(self, page: str, number: int, keys: Iterable[str]) -> None:
        """Takes in what a page says, unless something later from it is here already.

        Args:
            page: A name that the page made up for itself.
            number: Counts what it said.
            keys: All the keys that are held in it.
        """
        with self._lock:
            if number <= self._said.get(page, (-1,))[0]:
                return
            self._said.pop(page, None)  # to the end of the line
            while len(self._said) >= MOST_PAGES:
                del self._said[next(iter(self._said))]
            self._said[page] = (number, self._clock(), frozenset(self._known & set(keys)))

    def now(self) -> set[str]:
        """Returns the keys that are held in any page."""
        oldest = self._clock() - FORGOTTEN_S
        with self._lock:
            return {key for _, when, keys in self._said.values() if when > oldest for key in keys}
