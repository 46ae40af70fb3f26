"""The tools of the tool tasks: the L-shaped tool and the hammer. MuJoCo half sizes in metres, after the task zoo."""

from .primitives import FREE_JOINT, Body, Geom, Primitive, Vector

HOOK_MIDDLE = (0.11, 0.05, 0.0)
"""Centre of the hook in the L-tool's frame (m)."""

_HANDLE_HALF_LENGTH, _HANDLE_RADIUS, _HEAD = 0.02375, 0.012, 0.0132


def l_tool() -> Primitive:
    """Builds the red L-shaped tool, 0.25 kg: a bar along its x, and at the bar's far end a hook along its +y."""
    bar = Geom("box", (0.11, 0.011, 0.02), material="red_grain", friction=(0.0005, 0.005, 0.0001))
    hook = Geom("box", (0.006, 0.06, 0.02), HOOK_MIDDLE, "red_grain", friction=(0.005, 0.005, 0.0001))
    return Primitive("tool", Body("main", (bar, hook), joint=FREE_JOINT))


def hammer() -> Primitive:
    """Builds the hammer, 14 g: the handle along its x with the head at the far end, its face on the +y side.

    robosuite draws its hammer's sizes at construction, from numpy's global generator; these are the means of the zoo's
    ranges.
    """

    def part(
        kind: str, size: Vector, pos: Vector, material: str = "steel", quat: Vector = (1.0, 0.0, 0.0, 0.0)
    ) -> Geom:
        return Geom(kind, size, pos, material, quat=quat, density=175.0, friction=(4.0, 0.005, 0.0001))

    h, at = _HEAD, _HANDLE_HALF_LENGTH + _HEAD
    along_y, eighth_turn = (0.7071068, 0.7071068, 0.0, 0.0), (0.9238795, 0.0, 0.0, 0.3826834)
    geoms = (
        part("box", (_HANDLE_HALF_LENGTH, _HANDLE_RADIUS, _HANDLE_RADIUS), (0.0, 0.0, 0.0), "light_wood"),
        part("box", (h, 2 * h, h), (at, 0.0, 0.0)),
        part("cylinder", (0.8 * h, 0.2 * h), (at, 2.2 * h, 0.0), quat=along_y),
        part("cylinder", (h, 0.4 * h), (at, 2.8 * h, 0.0), quat=along_y),
        part("box", (0.7071 * h, 0.7071 * h, 0.95 * h), (at, -2.0 * h, 0.0), quat=eighth_turn),
    )
    return Primitive("hammer", Body("main", geoms, joint=FREE_JOINT))
