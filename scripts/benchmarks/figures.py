"""What the parts of the benchmark have in common: sizes, figures, and how something is timed."""

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Size:
    """How much of everything is done.

    Attributes:
        pixels: Side of the images.
        batch: Frames of a step of training.
        repeats: Timed repetitions.
        acts: Timed steps of acting.
        frames: Frames of a synthetic demonstration.
        recorded: Demonstrations recorded in the simulator.
        steps: Control steps that are rendered.
        profiles: In which render profiles.
        latents: Frames of the longest demonstration of which a tree is made.
        segments: Segments that are partitioned.
        demonstrations: Numbers of demonstrations over which the cost of a segmentation is drawn.
        skills: Numbers of skills over which the cost of a policy is drawn.
    """

    pixels: int
    batch: int
    repeats: int
    acts: int
    frames: int
    recorded: int
    steps: int
    profiles: tuple[str, ...]
    latents: int
    segments: int
    demonstrations: tuple[int, ...]
    skills: tuple[int, ...]


SIZES = {
    "tiny": Size(64, 4, 1, 5, 24, 1, 3, ("fastest",), 2_000, 300, (3, 6), (1, 2)),
    "usual": Size(
        128, 32, 5, 300, 150, 6, 60, ("fast", "fastest", "full"), 32_000, 20_000, (50, 100, 200, 400), (1, 3, 6, 11)
    ),
}
"""``tiny`` shows that all parts run and says nothing of speed; ``usual`` has the paper's networks and images."""


@dataclass(frozen=True)
class Setting:
    """What the parts are told.

    Attributes:
        size: How much is done.
        batch: Frames of a step of training.
        device: Where networks run.
        only: Part of the name of what shall be timed alone; empty for all.
        place: A folder for datasets and the like.
    """

    size: Size
    batch: int
    device: str
    only: str
    place: Path

    def asks_for(self, what: str) -> bool:
        """Tells whether something is to be timed."""
        return self.only in what


@dataclass(frozen=True)
class Figure:
    """One measured value.

    Attributes:
        what: What was measured.
        value: How much.
        unit: Its unit; a rate where it ends with ``/s``, else less is better.
        against: What else of the same part it is compared with.
        at: Where on the axis of a plot it belongs.
    """

    what: str
    value: float
    unit: str
    against: str = ""
    at: int | None = None

    def times(self, other: "Figure") -> float:
        """Says how many times as good it is as another of the same unit."""
        return self.value / other.value if self.unit.endswith("/s") else other.value / self.value


def alone[**P, T](work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Does some work in a process of its own: memory and OpenGL are as if nothing else had run."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(work, *args, **kwargs).result()


def largest_memory() -> float:
    """Tells how much memory this process has had at most (GiB), without its parent's, which `getrusage` counts."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (kibibytes,) = (line.split()[1] for line in lines if line.startswith("VmHWM:"))
    return int(kibibytes) / 2**20


def once(work: Callable[[], object]) -> float:
    """Times some work that cannot be repeated (s)."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def median_seconds(work: Callable[[], object], repeats: int) -> float:
    """Times some work; the first runs, as many as `warm_ups` says, do not count."""
    import torch  # not above: processes that only simulate do without

    seconds = []
    for _ in range(warm_ups(repeats) + repeats):
        began = time.perf_counter()
        work()
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds[warm_ups(repeats) :]))


def warm_ups(repeats: int) -> int:
    """Counts the runs that go before those that are timed."""
    return max(1, repeats // 4)
