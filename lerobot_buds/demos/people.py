"""Demonstrators that do what people do and the scripted ones do not: they wait, vary, overshoot, miss and try again.

The stages are those of the script. What differs is drawn anew for every episode; its magnitudes are held beside those
of people's own demonstrations in docs/human.md.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from lerobot_buds.envs import FPS, SimulationView

from .motions import COARSE, Action, Choice, Demonstrator, Target, Traits, Vec

_SPEED_MEMORY = 0.93
_STARTING = 12
"""Control steps within which a motion gathers speed."""

_FAR = 0.06
"""A motion shorter than this (m) is not overshot."""

_SLOWEST = 0.12
"""The least speed cap, in action units: below it the arm sags under what it carries and never arrives."""

_CORRECTED_WITHIN = 60
_GRIPPING = 0.15
"""The hand on its control device is as unsteady as can be where it commands at least this, in action units."""


@dataclass(frozen=True)
class Habits:
    """What a person does in one episode beside what `Traits` says.

    Attributes:
        thinking: Chance of a pause before a stage.
        slip: Chance that a grasp or a push misses.
        hook_slip: Chance that a hook does not come down behind what it is to fetch; it has it twice.
        overshoot: Chance that a motion through the air goes too far and is corrected.
        unevenness: Standard deviation of the logarithm of the speed within a motion.
        care: Share of the speed that is left where a motion ends.
        braking: Distance (m) from its end within which a motion slows down.
        contact: Share of the speed at which things are pushed, pulled, and approached to be grasped or set down.
    """

    thinking: float
    slip: float
    hook_slip: float
    overshoot: float
    unevenness: float
    care: float
    braking: float
    contact: float


def draw_habits(rng: np.random.Generator) -> Habits:
    """Draws one episode's habits. Ranges are ours, set by the figures of docs/human.md where those tell."""
    return Habits(
        thinking=rng.uniform(0.3, 0.9),
        slip=rng.uniform(0.05, 0.4),
        hook_slip=rng.uniform(0.2, 0.5),
        overshoot=rng.uniform(0.05, 0.35),
        unevenness=rng.uniform(0.15, 0.4),
        care=rng.uniform(0.2, 0.5),
        braking=rng.uniform(0.04, 0.08),
        contact=rng.uniform(0.35, 0.75),
    )


class Person(Demonstrator):
    """A demonstrator's hand that moves as people's do; arguments and attributes are those of `Demonstrator`."""

    patience = 500

    def __init__(
        self, state: SimulationView, rng: np.random.Generator, tremor_rng: np.random.Generator | None = None
    ) -> None:
        super().__init__(state, rng, tremor_rng)
        self.traits = Traits(
            speed=rng.uniform(0.45, 0.95),
            tremor=rng.uniform(0.02, 0.06),
            curve=rng.uniform(0.0, 0.3),
            hesitation=rng.uniform(0.05, 0.3),
        )
        self.habits = draw_habits(rng)

    def choose(self, scripted: Choice, people: Choice) -> Choice:
        """Takes what people do."""
        return people

    def slips(self, hooking: bool = False) -> bool:
        """Draws whether what comes next misses, and counts it among the `retries` then."""
        missed = bool(self.rng.random() < (self.habits.hook_slip if hooking else self.habits.slip))
        self.retries += missed
        return missed

    def notices(self, failed: bool) -> bool:
        """Sees what failed, and counts it among the `retries`."""
        self.retries += failed
        return failed

    def think(self, always: bool = False) -> Iterator[Action]:
        """Waits for 0.3 to 2 s, mostly briefly: with the chance of a pause before a stage, or always."""
        if always or self.rng.random() < self.habits.thinking:
            yield from self.hold(_pause(self.rng))

    def move(
        self, target: Target, tolerance: float = COARSE, until: Callable[[], bool] | None = None
    ) -> Iterator[Action]:
        """Moves as `Demonstrator.move` does: unevenly, slower towards the end, at times too far first."""
        way = target() - self.state.hand
        far = float(np.linalg.norm(way)) > _FAR
        if until is None and tolerance >= COARSE and far and self.rng.random() < self.habits.overshoot:
            yield from self._overshoot(target, way)
        motion = super().move(target, tolerance, until)
        if until is None or self.rng.random() > self.traits.hesitation:
            yield from motion
            return
        # Pushed or pulled in two goes: the end of such a motion is no distance, after which it could pause.
        yield from islice(motion, int(self.rng.integers(5, 40)))
        yield from self.hold(self._pause_length())
        yield from motion

    def _overshoot(self, target: Target, way: Vec) -> Iterator[Action]:
        """Goes past a target, never below it, and sees that."""
        beyond = way / np.linalg.norm(way) * self.rng.uniform(0.015, 0.045) + self.jitter(0.008)
        beyond[2] = max(beyond[2], 0.0)
        steps = 0

        def passed() -> bool:
            nonlocal steps
            steps += 1
            return steps > _CORRECTED_WITHIN or float(np.linalg.norm(target() + beyond - self.state.hand)) < COARSE

        yield from super().move(lambda: target() + beyond, until=passed)
        yield from self.hold(int(self.rng.integers(2, 9)))

    def _pace(self, speed: float, careful: bool) -> Callable[[float], float]:
        """Makes the speed of one motion: it gathers, wanders, and falls towards the end."""
        habits, level, steps = self.habits, 0.0, 0
        speed *= habits.contact if careful else 1.0
        fresh = np.sqrt(1.0 - _SPEED_MEMORY**2) * habits.unevenness

        def pace(left: float) -> float:
            nonlocal level, steps
            steps += 1
            level = _SPEED_MEMORY * level + self.rng.normal(0.0, fresh)
            start = min(1.0, 0.3 + 0.7 * steps / _STARTING)
            end = min(1.0, habits.care + (1.0 - habits.care) * left / habits.braking)
            return float(max(speed * start * end * np.exp(level), _SLOWEST))

        return pace

    def _pause_length(self) -> int:
        return _pause(self.rng)

    def _unsteadiness(self, wish: Vec) -> float:
        """A control device that nobody pushes gives no command, so a hand that waits is still."""
        return min(1.0, float(np.linalg.norm(wish)) / _GRIPPING)


def _pause(rng: np.random.Generator) -> int:
    """Draws a pause's length in control steps: 0.3 to 2 s, 0.8 s at its median."""
    return int(FPS * np.clip(rng.lognormal(np.log(0.8), 0.6), 0.3, 2.0))
