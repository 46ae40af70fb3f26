"""How the demonstrator does each stage of Tool-Use."""

from collections.abc import Iterator

import numpy as np

from .motions import Action, Demonstrator, Vec
from .vocabulary import Stage, carry, lift, persist, pick, release, sweep, up

_LYING, _CARRIED = 0.923, 1.005  # heights of the tool's origin (m); it hangs down towards the hook
_BEFORE_CUBE = np.array([-0.050, -0.05])  # tool's origin from the cube's, with the hook beyond the cube (m)
_HOOK = np.array([0.11, 0.05, 0.0])  # middle of the hook, in the tool's frame (m)
_SHORT = (0.155, 0.185)  # from the tool's origin to a cube that its hook, lowered, is still short of (m)
_BESIDE = ((-0.060, -0.050), (0.145, 0.160))  # from the tool's origin to a cube that its hook comes down beside (m, y)
_LEFT_IS_FREE = -0.13  # y of a fetched cube whose left has room for the hook beside the pot (m)
_HOOK_SLIPS = 2  # at most so often the hook comes down elsewhere
_OVER_POT = 0.115  # the released cube's height over the pot; the opening fingers must clear its handles (m)


def grasp_tool(hand: Demonstrator) -> Iterator[Action]:
    """Grasps the tool's bar towards its near end, so that the hook reaches beyond the workspace, and lifts it."""
    along_bar = np.array([hand.rng.uniform(*hand.choose((-0.09, -0.06), (-0.092, -0.048))), 0.0, 0.0])
    spread = hand.choose((0.003, 0.003, 0.002), (0.003, 0.003, 0.003))
    yield from pick(hand, lambda: hand.state.point_on("tool_main", along_bar), 0.08, spread)


def hook_cube(hand: Demonstrator) -> Iterator[Action]:
    """Carries the hook over the cube and lowers it behind; a hand that slips lowers it elsewhere first."""
    for _ in range(_HOOK_SLIPS):
        if hand.slips(hooking=True):
            yield from _miss_cube(hand)
    # People take the cube with any part of the hook.
    offset = hand.rng.uniform(*hand.choose(((-0.008, -0.010), (0.004, 0.010)), ((-0.008, -0.035), (0.004, 0.012))))
    yield from _lower_tool(hand, _BEFORE_CUBE + offset)


def _lower_tool(hand: Demonstrator, offset: Vec) -> Iterator[Action]:
    """Carries the tool high over a place, off the cube by ``offset`` (m), (2,), and lowers it to the table."""

    def place(height: float) -> Vec:
        return np.append(hand.state.position("cube_main")[:2] + offset, height)

    yield from carry(hand, "tool_main", lambda: place(_CARRIED), tolerance=0.012)
    yield from carry(hand, "tool_main", lambda: place(_LYING), tolerance=0.006)


def _miss_cube(hand: Demonstrator) -> Iterator[Action]:
    """Lowers the hook short of the cube or beside it, sees that, at times only while pulling, and lifts it again."""
    rng = hand.rng
    if rng.random() < 0.5:
        offset = np.array([-rng.uniform(*_SHORT), _BEFORE_CUBE[1] + rng.uniform(-0.02, 0.02)])
    else:
        offset = np.array([_BEFORE_CUBE[0] + rng.uniform(-0.01, 0.0), -rng.uniform(*_BESIDE[rng.integers(2)])])
    yield from _lower_tool(hand, offset)
    if rng.random() < 0.5:
        enough = hand.state.hand[0] - rng.uniform(0.02, 0.07)
        yield from sweep(hand, (-1.0, 0.0, 0.0), until=lambda: hand.state.hand[0] < enough)
    yield from hand.think(always=True)
    yield from lift(hand, _CARRIED - _LYING)


def pull_cube(hand: Demonstrator) -> Iterator[Action]:
    """Drags the cube towards the robot, hooking it again if it is lost, then frees the hook from it."""
    state = hand.state
    near = hand.rng.uniform(*hand.choose((-0.085, -0.06), (-0.095, -0.06)))
    lost = False

    def there() -> bool:
        return bool(state.position("cube_main")[0] < near)

    def go() -> Iterator[Action]:
        nonlocal lost
        if lost:
            yield from lift(hand, _CARRIED - _LYING)
            yield from _lower_tool(hand, _BEFORE_CUBE)
        lost = True
        yield from sweep(hand, (-1.0, 0.0, 0.0), until=lambda: there() or hand.choose(False, _passed_cube(hand)))

    yield from persist(hand, go, there)
    unhooked = state.hand + hand.rng.uniform((0.025, 0.0, 0.0), (0.035, 0.0, 0.0))
    yield from hand.move(lambda: unhooked, tolerance=0.008)
    yield from lift(hand, 0.06)


def _passed_cube(hand: Demonstrator) -> bool:
    """Tells whether the hook is nearer to the robot than the cube that it should fetch."""
    return bool(hand.state.point_on("tool_main", _HOOK)[0] < hand.state.position("cube_main")[0] - 0.01)


def put_tool_aside(hand: Demonstrator) -> Iterator[Action]:
    """Puts the tool down on the side of the cube that has room for it."""
    cube_y = hand.state.position("cube_main")[1]
    side = cube_y - 0.14 if cube_y > -0.19 else cube_y + 0.11
    if hand.choose(False, -0.19 < cube_y < _LEFT_IS_FREE) and hand.rng.random() < 0.5:
        side = cube_y + 0.11
    place = np.array([0.0, side, _LYING]) + hand.jitter(0.01) * hand.choose((1.0, 1.0, 0.0), (2.0, 1.0, 0.0))
    yield from carry(hand, "tool_main", lambda: place + up(0.06), tolerance=0.02)
    yield from carry(hand, "tool_main", lambda: place, tolerance=0.007)
    yield from release(hand, rise=0.08)


def grasp_cube(hand: Demonstrator) -> Iterator[Action]:
    """Grasps the cube from above and lifts it higher than the pot."""
    spread = hand.choose((0.003, 0.003, 0.002), (0.010, 0.003, 0.005))
    yield from pick(hand, lambda: hand.state.position("cube_main") - up(0.002), 0.12, spread, beside=0.045)


def put_cube_in_pot(hand: Demonstrator) -> Iterator[Action]:
    """Carries the cube over the pot, lowers it between the handles and lets go."""
    offset = hand.jitter(0.008) * (1.0, 1.0, 0.5)

    def over_pot(height: float) -> Vec:
        above: Vec = hand.state.position("pot_main") + up(height) + offset
        return above

    yield from carry(hand, "cube_main", lambda: over_pot(_OVER_POT + 0.05), tolerance=0.015)
    yield from carry(hand, "cube_main", lambda: over_pot(_OVER_POT))
    yield from release(hand, rise=0.04)


STAGES: dict[str, Stage] = {
    "grasp_tool": grasp_tool,
    "hook_cube": hook_cube,
    "pull_cube": pull_cube,
    "put_tool_aside": put_tool_aside,
    "grasp_cube": grasp_cube,
    "put_cube_in_pot": put_cube_in_pot,
}
"""The stages that this module knows."""
