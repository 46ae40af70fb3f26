"""The motions that scripted demonstrators are made of: closed-loop, at human speed, with human-like variety.

A motion is a generator of actions: it reads the present state before each action it yields, so slips and noise are
corrected the way a person corrects them, by looking.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import BudsError
from lerobot_buds.envs import FPS, REACH, SimulationView

Vec = NDArray[np.float64]
Action = NDArray[np.float32]
Target = Callable[[], Vec]
Choice = TypeVar("Choice")

COARSE = 0.012
"""A motion that must end more exactly than this (m) ends at a contact."""

_GAIN = 2.0
_TREMOR_MEMORY = 0.8


class MotionFailedError(BudsError):
    """A motion did not reach its end in time; the attempt is a failed one."""


@dataclass(frozen=True)
class Traits:
    """How a demonstrator moves in one episode.

    Attributes:
        speed: Mean speed cap of a motion, in action units: 0.625 is the SpaceMouse's limit, 1 is 0.27 m/s.
        tremor: Standard deviation of the correlated noise on the hand's command, in action units.
        curve: How far paths bow sideways, as a fraction of the way to go.
        hesitation: Chance that a motion is interrupted by a short pause.
    """

    speed: float
    tremor: float
    curve: float
    hesitation: float


def draw_traits(rng: np.random.Generator) -> Traits:
    """Draws one episode's traits. Ranges are ours: within SpaceMouse limits, with the paper's demonstration lengths."""
    return Traits(
        speed=rng.uniform(0.33, 0.625),
        tremor=rng.uniform(0.02, 0.08),
        curve=rng.uniform(0.0, 0.25),
        hesitation=rng.uniform(0.05, 0.35),
    )


class Demonstrator:
    """A scripted demonstrator's hand during one episode.

    Args:
        state: The true state of the simulation.
        rng: Source of all variety.
        tremor_rng: Source of the noise on the hand's command; a child of `rng` where None.

    Attributes:
        closed: What the gripper is told at every step, closed or open, until this is changed.
        intention: The latest action as it was meant: without the noise on the hand's command.
        retries: How often something was missed and done again; a script never does.
    """

    patience = 250
    """Length of a motion (control steps) after which it has failed."""

    def __init__(
        self, state: SimulationView, rng: np.random.Generator, tremor_rng: np.random.Generator | None = None
    ) -> None:
        self.state, self.rng = state, rng
        self._tremor_rng = tremor_rng or rng.spawn(1)[0]
        self.traits = draw_traits(rng)
        self.closed = False
        self.intention: Action = np.zeros(4, dtype=np.float32)
        self.retries = 0
        self._tremor: Vec = np.zeros(3)

    def jitter(self, spread: float) -> Vec:
        """Draws a displacement (m), uniform within ``spread`` along each axis, shape (3,)."""
        return self.rng.uniform(-spread, spread, 3)

    def choose(self, scripted: Choice, people: Choice) -> Choice:
        """Takes, of two ways to do something, the script's; `people.Person` takes the other."""
        return scripted

    def slips(self, hooking: bool = False) -> bool:
        """Tells whether what comes next misses: never, in a script."""
        return False

    def notices(self, failed: bool) -> bool:
        """Tells whether something that failed is seen and tried again: never, in a script."""
        return False

    def think(self, always: bool = False) -> Iterator[Action]:
        """Waits as people do before they go on: not at all, in a script."""
        yield from ()

    def move(
        self,
        target: Target,
        tolerance: float = COARSE,
        until: Callable[[], bool] | None = None,
    ) -> Iterator[Action]:
        """Moves the hand to a target that is looked at anew at every step.

        Args:
            target: Gives the position to reach (m), shape (3,).
            tolerance: Distance at which the target counts as reached (m).
            until: Ends the motion instead of the tolerance, where given.

        Raises:
            MotionFailedError: The end was not reached in time.
        """
        speed = self.traits.speed * self.rng.uniform(0.8, 1.2)
        start = target() - self.state.hand
        bow = self.traits.curve * self.rng.uniform(-1, 1) * np.cross(start, [0.0, 0.0, 1.0])
        distance = float(np.linalg.norm(start)) + 1e-9
        pause_at = self.rng.uniform(0.2, 0.8) * distance if self.rng.random() < self.traits.hesitation else -1.0
        pace = self._pace(speed, careful=until is not None or tolerance < COARSE)
        for _ in range(self.patience):
            error = target() - self.state.hand
            left = float(np.linalg.norm(error))
            if until() if until is not None else left < tolerance:
                return
            if left < pause_at:
                pause_at = -1.0
                yield from self.hold(self._pause_length())
            # The bow is widest half way and gone at both ends.
            progress = min(left / distance, 1.0)
            aim = error + 4.0 * bow * progress * (1.0 - progress)
            yield self._command(aim, pace(left))
        raise MotionFailedError(f"the hand did not arrive within {self.patience // FPS} seconds")

    def hold(self, steps: int) -> Iterator[Action]:
        """Stays where it is for some control steps, while the gripper closes or opens."""
        place = self.state.hand
        for _ in range(steps):
            yield self._command(place - self.state.hand, self.traits.speed)

    def _pace(self, speed: float, careful: bool) -> Callable[[float], float]:
        """Makes the speed cap of one motion, by the distance that is left (m): constant in a script.

        Args:
            speed: The motion's mean (action units).
            careful: It ends at a contact, or goes on in contact.
        """
        return lambda left: speed

    def _pause_length(self) -> int:
        """Draws the length of a pause within a motion (control steps)."""
        return int(self.rng.integers(3, 13))

    def _unsteadiness(self, wish: Vec) -> float:
        """Tells what share of the tremor a command has, (3,) in action units."""
        return 1.0

    def _command(self, aim: Vec, speed: float) -> Action:
        # Held against the direction of motion, so that the path stays straight at the speed cap.
        wish = _GAIN * aim / REACH
        wish *= min(1.0, speed / (float(np.linalg.norm(wish)) + 1e-9))
        # The stationary deviation of this process is `tremor`.
        fresh = np.sqrt(1.0 - _TREMOR_MEMORY**2) * self.traits.tremor
        self._tremor = _TREMOR_MEMORY * self._tremor + self._tremor_rng.normal(0.0, fresh, 3)
        self.intention = self._action(wish)
        return self._action(wish + self._unsteadiness(wish) * self._tremor)

    def _action(self, displacement: Vec) -> Action:
        return np.append(np.clip(displacement, -1.0, 1.0), 1.0 if self.closed else -1.0).astype(np.float32)
