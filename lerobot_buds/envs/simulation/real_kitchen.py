"""A simulated twin of the paper's hardware task: lid, pot, tray and tool. The geometry is ours."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from .furniture import pot
from .primitives import FREE_JOINT, Body, Geom, Primitive, Vector
from .state import SimulationState
from .tools import l_tool

_POT_HEIGHT = 0.9035
_TRAY_HEIGHT = 0.9005
_TOOL_HEIGHT = 0.9205
_LID_ABOVE_POT = 0.0725


@dataclass(frozen=True)
class RealKitchen:
    """Takes the lid off, puts the pot on the tray, pushes both aside with the tool.

    Attributes:
        start: Nothing: this scene has one start.
        goal: Facts that must all hold.
    """

    start: frozenset[str]
    goal: tuple[str, ...]
    table_length: float = 1.0
    latches: Mapping[str, str] = field(default_factory=lambda: {"tool_has_been_lifted": "tool_lifted"})

    def objects(self) -> list[Primitive]:
        """Builds the pot, its lid, the tray and the tool."""
        return [pot(), lid(), tray(), l_tool()]

    def place(self, state: SimulationState, rng: np.random.Generator) -> None:
        """Draws and writes the start positions: the lid on the pot, everything at rest."""
        pot_at = np.array([rng.uniform(-0.10, -0.06), rng.uniform(0.14, 0.18), _POT_HEIGHT])
        state.set_pose("pot", pot_at, 0.0)
        state.set_pose("lid", pot_at + np.array([0.0, 0.0, _LID_ABOVE_POT]), 0.0)
        state.set_pose("tray", np.array([rng.uniform(0.0, 0.04), rng.uniform(-0.02, 0.02), _TRAY_HEIGHT]), 0.0)
        state.set_pose("tool", np.array([rng.uniform(-0.08, -0.04), rng.uniform(-0.30, -0.24), _TOOL_HEIGHT]), 0.0)

    def update(self, state: SimulationState) -> None:
        """Does nothing: no look of this scene depends on its state."""

    def facts(self, state: SimulationState) -> dict[str, bool]:
        """Evaluates the predicates of the goal and of the stages."""
        pot_at, lid_at = state.position("pot_main"), state.position("lid_main")
        tray_at, tool_at = state.position("tray_main"), state.position("tool_main")
        off_tray = pot_at - tray_at
        return {
            "lid_off": bool(lid_at[2] < 0.94 and np.hypot(*(lid_at - pot_at)[:2]) > 0.10),
            "pot_on_tray": bool((np.abs(off_tray[:2]) < 0.03).all() and 0.003 < off_tray[2] < 0.03),
            "tray_aside": bool(tray_at[1] > 0.14),
            "tool_lifted": bool(tool_at[2] > _TOOL_HEIGHT + 0.02),
            "tool_put_down": bool(tool_at[2] < 0.93 and not state.touching("tool", "gripper0")),
        }


def lid() -> Primitive:
    """Builds the lid: its step sits between the pot's walls, its knob fits between the fingers."""

    def plate(size: Vector, height: float) -> Geom:
        # Not of steel: lid and pot could hardly be told apart.
        return Geom("box", size, (0.0, 0.0, height), material="blue_wood", density=400.0)

    knob = Geom(
        "box",
        (0.014, 0.010, 0.016),
        (0.0, 0.0, 0.020),
        material="red_wood",
        density=400.0,
        friction=(1.5, 0.005, 0.0001),
    )
    geoms = (plate((0.055, 0.048, 0.004), 0.0), plate((0.039, 0.042, 0.004), -0.008), knob)
    return Primitive("lid", Body("main", geoms, joint=FREE_JOINT))


def tray() -> Primitive:
    """Builds the tray; its rim makes pot and tray move together when one of them is pushed."""

    def wood(size: Vector, pos: Vector) -> Geom:
        return Geom("box", size, pos, material="green_wood", density=600.0, friction=(0.5, 0.005, 0.0001))

    rims = [wood((0.003, 0.086, 0.004), (x, 0.0, 0.014)) for x in (-0.073, 0.073)]
    rims += [wood((0.070, 0.003, 0.004), (0.0, y, 0.014)) for y in (-0.083, 0.083)]
    base = wood((0.076, 0.086, 0.005), (0.0, 0.0, 0.005))
    return Primitive("tray", Body("main", (base, *rims), joint=FREE_JOINT))
