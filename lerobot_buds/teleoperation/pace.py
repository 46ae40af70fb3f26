"""How evenly LeRobot's loop calls the robot: the period between observations within an episode."""

import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

SLACK = 0.05
"""A median period that differs from that of the simulation by more than this share is worth a warning (ours)."""


@dataclass
class Pace:
    """Periods of the control loop.

    Attributes:
        periods: Seconds between an observation and the next, of all episodes.
    """

    periods: list[float] = field(default_factory=list)
    _last: float | None = None

    def tick(self) -> None:
        """Tells that the robot was observed."""
        now = time.perf_counter()
        if self._last is not None:
            self.periods.append(now - self._last)
        self._last = now

    def pause(self) -> None:
        """Tells that what comes next is another episode: the time between two is no period."""
        self._last = None

    def quantiles(self) -> NDArray[np.float64]:
        """Returns the median and the 99th percentile (s), ``(2,)``; NaN where there are no periods."""
        return np.array([np.quantile(self.periods, q) if self.periods else np.nan for q in (0.5, 0.99)])

    def describe(self) -> str:
        """Says the periods in a sentence's part, in milliseconds."""
        median, p99 = 1000 * self.quantiles()
        return f"period of the loop: median {median:.1f} ms, 99th percentile {p99:.1f} ms"

    def differs_from(self, fps: float) -> bool:
        """Tells whether the loop ran at another rate than the simulation, where that can be judged.

        Args:
            fps: Steps per second.
        """
        return len(self.periods) >= fps and abs(self.quantiles()[0] * fps - 1) > SLACK
