"""The clock of simulator states: their rate, and rows at another one."""

import logging
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import ConfigError, DatasetError

from .source import Source

logger = logging.getLogger(__name__)

_EVEN = 0.01
"""Steps that differ by less than this share of their length are equally long: times are sums of physics steps."""


@dataclass(frozen=True)
class Clock:
    """What the times of states say.

    Attributes:
        fps: States per second; None where they are not equally far apart.
        facts: The same as plain data, with the shortest and the longest step (seconds).
    """

    fps: float | None
    facts: dict[str, Any]

    @classmethod
    def of(cls, states: dict[str, NDArray[np.float64]], told: float | None, source: Source) -> Self:
        """Reads the clock of all demonstrations, the first number of a state, and compares it with what is told.

        Args:
            states: ``(T, S)`` by the demonstration's name.
            told: The rate that the file names (frames per second), where it does.
            source: The settings, and where the states are from.

        Raises:
            ConfigError: The rate to resample at is none, or above that of the states.
            DatasetError: The steps are not equally long, and nothing was said about it; the file names another rate.
        """
        steps = np.concatenate([np.diff(rows[:, 0]) for rows in states.values()])
        if not len(steps):
            return cls(told, {"told": told})
        middle = float(np.median(steps))
        rate = round(1 / float(steps.mean()), 3) if steps.mean() > 0 else 0.0
        even = middle > 0 and bool(np.all(np.abs(steps - middle) <= _EVEN * middle))
        facts = {"shortest_step_s": float(steps.min()), "longest_step_s": float(steps.max()), "told": told}
        _check_resampling(source, rate)
        if source.resample is not None:
            logger.info(
                "%s: %g rows a second are taken of some %g, the nearest in time.", source.path, source.resample, rate
            )
            return cls(None, facts | {"resampled": source.resample})
        if even and told is not None and abs(rate - told) > _EVEN * told:
            raise DatasetError(
                f"{source.path}: its states are {rate:g} a second, but its attributes say control_freq={told:g}. "
                "Say at which rate rows are wanted with --resample."
            )
        if not even and not source.uneven:
            raise DatasetError(
                f"{source.path}: its states are {steps.min():.3f} to {steps.max():.3f} s apart, so that they have no "
                f"rate (on average {rate:g} a second). Take rows at a constant one with --resample=20, or all rows as "
                f"if they were equally far apart with --uneven=true --fps={rate:.0f}."
            )
        return cls((told or rate) if even else None, facts | {"uneven": not even})


def _check_resampling(source: Source, rate: float) -> None:
    if source.resample is None:
        return
    if not 0 < source.resample <= rate * (1 + _EVEN):
        raise ConfigError(
            f"resample={source.resample:g} cannot work: {source.path} has {rate:g} states a second, and rows between "
            "them are not made up."
        )
    if source.uneven:
        raise ConfigError("resample and uneven exclude each other: leave out one of them.")


def resampled(times: NDArray[np.float64], rate: float | None) -> NDArray[np.int64]:
    """Picks the rows that are nearest in time to those of a constant rate.

    Args:
        times: ``(T,)`` times of the rows (s), ascending.
        rate: Rows per second; None for all rows.

    Returns:
        Numbers of the rows, the first one included.
    """
    if rate is None:
        return np.arange(len(times))
    wanted = times[0] + np.arange(int((times[-1] - times[0]) * rate + 1e-9) + 1) / rate
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    if len(times) == 1:
        return np.zeros(1, dtype=np.int64)
    nearer = wanted - times[after - 1] <= times[after] - wanted
    return np.where(nearer, after - 1, after).astype(np.int64)
