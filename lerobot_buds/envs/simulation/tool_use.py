"""The Tool-Use scene: a cube beyond the hand's reach, an L-shaped tool to fetch it with, and a pot to put it in."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from .furniture import cube, pot
from .kitchen_facts import cube_in_pot
from .primitives import Primitive
from .state import SimulationState
from .tools import HOOK_MIDDLE, l_tool

_POT = np.array([0.0, 0.18, 0.9035])
_CUBE_HALF_SIZE = (0.020, 0.025, 0.020)
_CUBE_YAW = -np.pi / 2


@dataclass(frozen=True)
class ToolUse:
    """The task from its start, or from the moment when the cube is fetched.

    Attributes:
        start: ``cube_fetched`` to start with the cube within reach and the tool put down beyond it (the shorter task of
            the paper's comparison); the arm is at its home all the same (ours).
        goal: Facts that must all hold.
    """

    start: frozenset[str]
    goal: tuple[str, ...]
    table_length: float = 0.8
    latches: Mapping[str, str] = field(default_factory=dict)

    def objects(self) -> list[Primitive]:
        """Builds the pot, the cube and the tool."""
        return [pot(), cube(_CUBE_HALF_SIZE, "blue_wood"), l_tool()]

    def place(self, state: SimulationState, rng: np.random.Generator) -> None:
        """Draws and writes the start positions; the plain start's ranges are the task zoo's.

        Both starts draw the same numbers in the same order.
        """
        cube_at = np.array([rng.uniform(0.09, 0.12), rng.uniform(-0.25, -0.10), 0.93])
        tool_at = np.array([rng.uniform(-0.14, -0.12), rng.uniform(-0.23, -0.03), 0.94])
        cube_fetched = np.array([rng.uniform(-0.09, -0.06), cube_at[1], 0.93])
        tool_put_down = np.array([0.0, fetched_tool_y(cube_at[1]) + rng.uniform(-0.01, 0.01), 0.93])
        fetched = "cube_fetched" in self.start
        state.set_pose("pot", _POT, 0.0)
        state.set_pose("cube", cube_fetched if fetched else cube_at, _CUBE_YAW)
        state.set_pose("tool", tool_put_down if fetched else tool_at, 0.0)

    def update(self, state: SimulationState) -> None:
        """Nothing changes its looks here."""

    def facts(self, state: SimulationState) -> dict[str, bool]:
        """Evaluates the zoo's predicate, that the cube touches the pot and their origins are close, and the stages'."""
        cube_at, tool_at = state.position("cube_main"), state.position("tool_main")
        beyond = state.point_on("tool_main", np.array(HOOK_MIDDLE)) - cube_at
        fetched, lying = bool(cube_at[0] < -0.05), tool_at[2] < 0.93
        return {
            "cube_in_pot": cube_in_pot(state),
            "cube_lifted": bool(cube_at[2] > 0.94),
            "cube_fetched": fetched,
            "cube_hooked": bool(0.0 < beyond[0] < 0.11 and abs(beyond[1]) < 0.06 and abs(beyond[2]) < 0.02),
            "tool_lifted": bool(tool_at[2] > 0.94),
            # Far enough from the fetched cube for the open fingers.
            "tool_put_aside": bool(
                fetched and lying and abs(tool_at[1] - cube_at[1]) > 0.08 and not state.touching("tool", "gripper0")
            ),
        }


def fetched_tool_y(cube_y: float) -> float:
    """Tells where the tool lies once put down, out of the way of a hand that grasps the cube at ``cube_y`` (m)."""
    return cube_y - 0.14 if cube_y > -0.19 else cube_y + 0.11
