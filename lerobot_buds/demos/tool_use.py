"""How the demonstrator does each stage of Tool-Use."""

from collections.abc import Iterator

import numpy as np

from .motions import Action, Demonstrator, Vec
from .vocabulary import Stage, carry, grasp, lift, release, sweep, up

_LYING, _CARRIED = 0.923, 1.005  # heights of the tool's origin (m); it hangs down towards the hook
_BEFORE_CUBE = np.array([-0.050, -0.05])  # tool's origin from the cube's, with the hook beyond the cube (m)
_OVER_POT = 0.115  # the released cube's height over the pot; the opening fingers must clear its handles (m)


def grasp_tool(hand: Demonstrator) -> Iterator[Action]:
    """Grasps the tool's bar towards its near end, so that the hook reaches beyond the workspace, and lifts it."""
    along_bar = np.array([hand.rng.uniform(-0.09, -0.06), 0.0, 0.0])
    yield from grasp(hand, lambda: hand.state.point_on("tool_main", along_bar))
    yield from lift(hand, 0.08)


def hook_cube(hand: Demonstrator) -> Iterator[Action]:
    """Carries the hook over the cube and lowers it behind."""
    offset = hand.rng.uniform((-0.008, -0.010), (0.004, 0.010))

    def beyond_cube(height: float) -> Vec:
        return np.append(hand.state.position("cube_main")[:2] + _BEFORE_CUBE + offset, height)

    yield from carry(hand, "tool_main", lambda: beyond_cube(_CARRIED), tolerance=0.012)
    yield from carry(hand, "tool_main", lambda: beyond_cube(_LYING), tolerance=0.006)


def pull_cube(hand: Demonstrator) -> Iterator[Action]:
    """Drags the cube towards the robot, then frees the hook from it."""
    near = hand.rng.uniform(-0.085, -0.06)
    yield from sweep(hand, (-1.0, 0.0, 0.0), until=lambda: hand.state.position("cube_main")[0] < near)
    unhooked = hand.state.hand + hand.rng.uniform((0.025, 0.0, 0.0), (0.035, 0.0, 0.0))
    yield from hand.move(lambda: unhooked, tolerance=0.008)
    yield from lift(hand, 0.06)


def put_tool_aside(hand: Demonstrator) -> Iterator[Action]:
    """Puts the tool down on the side of the cube that has room for it."""
    cube_y = hand.state.position("cube_main")[1]
    side = cube_y - 0.14 if cube_y > -0.19 else cube_y + 0.11
    place = np.array([0.0, side, _LYING]) + hand.jitter(0.01) * (1.0, 1.0, 0.0)
    yield from carry(hand, "tool_main", lambda: place + up(0.06), tolerance=0.02)
    yield from carry(hand, "tool_main", lambda: place, tolerance=0.007)
    yield from release(hand, rise=0.08)


def grasp_cube(hand: Demonstrator) -> Iterator[Action]:
    """Grasps the cube from above and lifts it higher than the pot."""
    yield from grasp(hand, lambda: hand.state.position("cube_main") - up(0.002))
    yield from lift(hand, 0.12)


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
