"""What a hand does with things: the small vocabulary that every demonstrator is written in.

Each word is a generator of actions for the hand given first, and draws its own variety from that hand's generator.
Heights, reaches and spreads are in metres, directions are unit vectors in the world's frame.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from .motions import Action, Demonstrator, MotionFailedError, Target, Vec

Stage = Callable[[Demonstrator], Iterator[Action]]
"""How one stage of a task is done."""

_MISJUDGED = 0.25
_FAR_AHEAD = 0.10
_TRIES = 4
_TOO_HIGH = (0.034, 0.050)
"""Range of the height (m) over a point to grasp at which fingers that close catch nothing of any object here."""

_PAST = 0.06
"""How far (m) beyond what it should have pushed a hand goes before it sees that it missed."""


def up(height: float) -> Vec:
    """Makes the upward displacement of a height (m), shape (3,)."""
    return np.array([0.0, 0.0, height])


def approach(hand: Demonstrator, target: Target, hover: tuple[float, float] = (0.07, 0.11)) -> Iterator[Action]:
    """Comes over a point; now and then misjudges where it is, sees that, and corrects.

    Args:
        hand: The hand, which keeps its grip.
        target: The point to hover over (m).
        hover: Range of the height above it (m).
    """
    height = up(hand.rng.uniform(*hover))
    if hand.rng.random() < _MISJUDGED:
        astray = hand.jitter(0.03)
        yield from hand.move(lambda: target() + height + astray, tolerance=0.025)
    yield from hand.move(lambda: target() + height, tolerance=0.015)


def persist(hand: Demonstrator, go: Callable[[], Iterator[Action]], done: Callable[[], bool]) -> Iterator[Action]:
    """Does something, and does it again where the hand notices that it is not done.

    Args:
        hand: The hand.
        go: What to do.
        done: Tells whether it worked.

    Raises:
        MotionFailedError: It did not work in four tries.
    """
    yield from go()
    for _ in range(_TRIES - 1):
        if not hand.notices(not done()):
            return
        yield from hand.think(always=True)
        yield from go()
    if hand.notices(not done()):
        raise MotionFailedError(f"the hand gave up after {_TRIES} tries")


def grasp(
    hand: Demonstrator,
    target: Target,
    spread: Sequence[float] = (0.003, 0.003, 0.002),
    hover: tuple[float, float] = (0.07, 0.11),
    beside: float = 0.0,
) -> Iterator[Action]:
    """Opens the gripper, comes down on a point from above and closes; a hand that slips closes on nothing first.

    Args:
        hand: The hand.
        target: Where the point between the fingertips is to be (m); the fingers open along y.
        spread: The grasp is off this point by up to so much along each axis (m).
        hover: Range of the height above it from which the hand comes down (m).
        beside: Displacement along x (m) at which open fingers come down beside the object and meet nothing else; 0
            where there is none.
    """
    offset = hand.rng.uniform(-1.0, 1.0, 3) * spread
    hand.closed = False
    yield from approach(hand, target, hover)
    if hand.slips():
        yield from _close_on_nothing(hand, target, beside)
    yield from hand.move(lambda: target() + offset, tolerance=0.006)
    hand.closed = True
    yield from hand.hold(int(hand.rng.integers(10, 15)))


def _close_on_nothing(hand: Demonstrator, target: Target, beside: float) -> Iterator[Action]:
    """Closes too early or beside the object, sees that, opens again and rises."""
    astray = up(hand.rng.uniform(*_TOO_HIGH))
    if beside and hand.rng.random() < 0.5:
        astray = np.array([beside * hand.rng.uniform(1.0, 1.2), 0.0, 0.0])
    yield from hand.move(lambda: target() + astray, tolerance=0.006)
    hand.closed = True
    yield from hand.hold(int(hand.rng.integers(8, 20)))
    if hand.rng.random() < 0.5:
        yield from lift(hand, 0.04)
    yield from release(hand, rise=hand.rng.uniform(0.02, 0.05))


def pick(
    hand: Demonstrator,
    target: Target,
    height: float,
    spread: Sequence[float] = (0.003, 0.003, 0.002),
    beside: float = 0.0,
) -> Iterator[Action]:
    """Grasps at a point, see `grasp`, and lifts by at least a height (m); again if the object stays where it is."""
    lying = target()[2]

    def go() -> Iterator[Action]:
        yield from grasp(hand, target, spread, beside=beside)
        yield from lift(hand, height)

    yield from persist(hand, go, lambda: bool(target()[2] > lying + height / 2))


def lift(hand: Demonstrator, height: float) -> Iterator[Action]:
    """Raises the hand, and what it holds, by at least this height (m)."""
    top = hand.state.hand + up(height * hand.rng.uniform(1.0, 1.2))
    yield from hand.move(lambda: top, tolerance=0.015)


def carry(hand: Demonstrator, body: str, goal: Target, tolerance: float = 0.010) -> Iterator[Action]:
    """Moves what the hand holds until the body itself is at the goal, so that a grasp off its centre does no harm.

    Args:
        hand: The hand.
        body: The body held.
        goal: Where its origin is to be (m).
        tolerance: Distance at which it is there (m).
    """
    state = hand.state
    yield from hand.move(lambda: state.hand + goal() - state.position(body), tolerance=tolerance)


def release(hand: Demonstrator, rise: float) -> Iterator[Action]:
    """Opens the gripper and raises the hand by at least this height (m)."""
    hand.closed = False
    yield from hand.hold(int(hand.rng.integers(7, 12)))
    yield from lift(hand, rise)


def sweep(
    hand: Demonstrator, along: Sequence[float] | Vec, until: Callable[[], bool], through: Target | None = None
) -> Iterator[Action]:
    """Moves straight in one direction and takes along what the hand holds or meets: a pull as well as a push.

    Args:
        hand: The hand, which keeps its grip.
        along: Unit vector of the direction.
        until: Ends the motion.
        through: A point of the line to follow (m), looked at anew at every step; None for the hand's present place.
    """
    direction, here = np.array(along), hand.state.hand

    def ahead() -> Vec:
        point = here if through is None else through()
        advance = float(direction @ (hand.state.hand - point))
        aim: Vec = point + (advance + _FAR_AHEAD) * direction
        return aim

    yield from hand.move(ahead, until=until)


def push(
    hand: Demonstrator,
    start: Target,
    along: Sequence[float] | Vec,
    until: Callable[[], bool],
    hover: tuple[float, float] | None = None,
    over: float = 0.0,
) -> Iterator[Action]:
    """Closes the hand, goes to where the push starts and pushes; a hand that slips passes over it first.

    Args:
        hand: The hand.
        start: Where the push starts (m), short of what is pushed; followed sideways during the push.
        along: Unit vector of the push.
        until: Ends the push.
        hover: Range of the height (m) from which the hand comes down to the start; None to go there straight.
        over: Height (m) over the start at which a hand that slips passes over what it should push; 0 for never.
    """
    hand.closed = True
    if over and hand.slips():
        yield from _push_nothing(hand, lambda: start() + up(over), along)
    if hover is not None:
        yield from approach(hand, start, hover)
    yield from hand.move(start)
    yield from sweep(hand, along, until, through=start)


def _push_nothing(hand: Demonstrator, start: Target, along: Sequence[float] | Vec) -> Iterator[Action]:
    """Passes over what should be pushed, sees that, and comes back above it."""
    yield from hand.move(start)
    direction, begin = np.array(along), hand.state.hand
    reach = 0.11 + hand.rng.uniform(0.0, _PAST)
    yield from sweep(hand, along, until=lambda: bool(direction @ (hand.state.hand - begin) > reach), through=start)
    yield from hand.think(always=True)


def draw_back(hand: Demonstrator, low: Sequence[float] | Vec, high: Sequence[float] | Vec) -> Iterator[Action]:
    """Moves away by a displacement drawn between two corners (m), with the present grip."""
    back = hand.state.hand + hand.rng.uniform(low, high)
    yield from hand.move(lambda: back, tolerance=0.025)
