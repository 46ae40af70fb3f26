"""Statistics of rollouts, from the report that ``lerobot-eval`` writes."""

from dataclasses import dataclass
from pathlib import Path

from scipy.stats import binomtest

from lerobot_buds.core import DatasetError, read_json


@dataclass(frozen=True)
class SuccessRate:
    """How often an evaluation succeeded.

    Attributes:
        successes: Number of successful episodes.
        episodes: Number of episodes.
        low: Lower end of the 95 % interval of the rate (Wilson).
        high: Upper end of it.
    """

    successes: int
    episodes: int
    low: float
    high: float

    @property
    def rate(self) -> float:
        """Share of successful episodes, in [0, 1]."""
        return self.successes / self.episodes

    def __str__(self) -> str:
        """Formats rate, counts and interval on one line."""
        return (
            f"{self.rate:.0%} success ({self.successes} of {self.episodes}; "
            f"95 % interval {self.low:.0%} to {self.high:.0%})"
        )


def success_rate(successes: int, episodes: int) -> SuccessRate:
    """Computes a success rate with its 95 % Wilson interval."""
    interval = binomtest(successes, episodes).proportion_ci(confidence_level=0.95, method="wilson")
    return SuccessRate(successes, episodes, float(interval.low), float(interval.high))


def read_success_rate(report: Path) -> SuccessRate:
    """Reads the success rate over all tasks of an evaluation.

    Args:
        report: The file ``eval_info.json`` of ``lerobot-eval``.

    Raises:
        DatasetError: The report holds no episodes.
    """
    successes = [ok for task in read_json(report)["per_task"] for ok in task["metrics"]["successes"]]
    if not successes:
        raise DatasetError(f"{report} holds no episodes; run lerobot-eval again.")
    return success_rate(sum(successes), len(successes))
