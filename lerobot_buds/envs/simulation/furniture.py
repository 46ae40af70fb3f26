"""The objects and fixtures that the kitchen tasks share: pot, cube, cabinet, stove, button, serving region.

Sizes and masses are those of the original task zoo; MuJoCo half sizes in metres. Fixtures take their place in the world
as an argument, free objects are placed at every reset.
"""

from .primitives import FREE_JOINT, Body, Geom, Inertia, Primitive, Vector

# The zoo writes the cabinet's slide range as -0.04..0 without enforcing it; enforced, the drawer would open 4 cm only.
# Contacts are its stops.
_DRAWER_JOINT = {"name": "slide", "type": "slide", "axis": "0 1 0", "damping": "100", "limited": "false"}
_SWITCH_JOINT = {
    "name": "hinge",
    "type": "hinge",
    "axis": "1 0 0",
    "pos": "0 0 0",
    "range": "-0.3 0.3",
    "limited": "true",
    "damping": "0.1",
    "frictionloss": "0.1",
}

HANDLE_BAR = (0.0, -0.16, 0.04)
"""Centre of the drawer's handle bar in the drawer's frame (m)."""


def pot() -> Primitive:
    """Builds the steel pot: 0.553 kg, handles along its y walls, resting height 0.0025 m above its support."""

    def steel(size: Vector, pos: Vector, sliding: float = 0.005) -> Geom:
        return Geom("box", size, pos, material="steel", friction=(sliding, 0.005, 0.0001))

    walls = [steel((0.057, 0.007, 0.035), (0.0, y, 0.0325)) for y in (-0.06, 0.06)]
    walls += [steel((0.007, 0.053, 0.035), (x, 0.0, 0.0325)) for x in (0.05, -0.05)]
    bars = [steel((0.0275, 0.007, 0.010), (0.0, y, 0.077)) for y in (0.06, -0.06)]
    floor = steel((0.043, 0.053, 0.005), (0.0, 0.0, 0.0025), sliding=0.0005)
    return Primitive("pot", Body("main", (floor, *walls, *bars), joint=FREE_JOINT))


def cube(half_size: Vector, material: str) -> Primitive:
    """Builds a small free cube of 500 kg/m^3."""
    return Primitive(
        "cube", Body("main", (Geom("box", half_size, material=material, density=500.0),), joint=FREE_JOINT)
    )


def cabinet(pos: Vector, quat: Vector, body_material: str, extra_posts: bool) -> Primitive:
    """Builds a cabinet with one drawer, which opens along the cabinet's own -y.

    Args:
        pos: Centre of its base in the world (m).
        quat: Orientation in the world (w, x, y, z).
        body_material: Look of the cabinet and of the drawer's front.
        extra_posts: Adds the posts of the multitask kitchen, which stop the drawer at -0.105 m instead of -0.135 m.
    """

    def box(size: Vector, place: Vector, material: str = body_material) -> Geom:
        return Geom("box", size, place, material=material)

    shell = [box((0.008, 0.112, 0.064), (x, 0.0, 0.065)) for x in (-0.11, 0.11)]
    shell += [
        box((0.102, 0.008, 0.064), (0.0, 0.092, 0.062)),
        box((0.102, 0.102, 0.014), (0.0, -0.008, 0.004)),
        box((0.102, 0.102, 0.008), (0.0, 0.01, 0.121)),
    ]
    post_rows = (-0.10, -0.07) if extra_posts else (-0.10,)
    shell += [box((0.012, 0.012, 0.064), (x, y, 0.065)) for y in post_rows for x in (-0.102, 0.102)]
    floor_height = -0.045 if extra_posts else -0.040
    tray = [
        box((0.088, 0.010, 0.046), (0.0, -0.095, 0.007)),
        box((0.095, 0.008, 0.028), (0.0, 0.065, 0.008)),
        *(box((0.008, 0.084, 0.028), (x, 0.0, 0.0)) for x in (-0.072, 0.072)),
        box((0.08, 0.09, 0.008), (0.0, 0.0, floor_height)),
    ]
    along_y, along_x = (0.7071068, 0.7071068, 0.0, 0.0), (0.7071068, 0.0, 0.7071068, 0.0)
    handle = [
        *(Geom("capsule", (0.009, 0.03), (x, -0.13, 0.04), "dark_wood", quat=along_y) for x in (-0.05, 0.05)),
        Geom("capsule", (0.009, 0.05), HANDLE_BAR, "dark_wood", quat=along_x),
    ]
    drawer = Body(
        "drawer",
        (*tray, *handle),
        pos=(0.0, -0.01, 0.076),
        joint=_DRAWER_JOINT,
        inertia=Inertia(7.854, (0.0, 0.0, 0.35), (0.923, 0.765, 0.169), (0.5, 0.5, 0.5, 0.5)),
    )
    return Primitive("cabinet", Body("main", tuple(shell), pos, quat, children=(drawer,)))


def stove(pos: Vector) -> Primitive:
    """Builds the fixed stove with painted burner rings; the disc ``stove_flame`` is shown while the stove is on."""
    rings = [
        Geom(
            "cylinder",
            (radius, 0.0004),
            (0.0, 0.0, 0.0226 + 0.0002 * number),
            rgba=(grey, grey, grey, 1.0),
            role="visual",
        )
        for number, (radius, grey) in enumerate([(0.060, 0.15), (0.045, 0.45), (0.030, 0.15), (0.015, 0.45)])
    ]
    # Wider than the zoo's 0.0625, which a pot on the stove would hide from both cameras.
    flame = Geom(
        "cylinder", (0.09, 0.0004), (0.0, 0.0, 0.0236), rgba=(1.0, 0.15, 0.05, 0.0), role="visual", name="flame"
    )
    plate = Geom("box", (0.095, 0.095, 0.0005), (0.0, 0.0, 0.022), role="collision")
    block = Geom("box", (0.095, 0.095, 0.02), material="metal")
    return Primitive("stove", Body("main", (block, plate, *rings, flame), pos))


def button(pos: Vector) -> Primitive:
    """Builds the stove's lever, turned by 180 degrees: pushed towards world +y it switches on, towards -y off."""
    switch = Body(
        "switch",
        (
            Geom("box", (0.025, 0.007, 0.025), (0.0, 0.0, 0.05), material="metal"),
            Geom(
                "cylinder",
                (0.0325, 0.0125),
                (0.0, 0.0, 0.08),
                material="red_wood",
                quat=(0.7071068, 0.7071068, 0.0, 0.0),
            ),
        ),
        pos=(0.0, 0.0, 0.03),
        joint=_SWITCH_JOINT,
        inertia=Inertia(0.2435, (0.0297, -0.0015, 0.0), (0.0914, 0.0522, 0.0437), (0.7011, 0.0, 0.0, 0.7131)),
    )
    base = Geom("cylinder", (0.04, 0.02), material="metal")
    return Primitive("button", Body("main", (base,), pos, (0.0, 0.0, 0.0, 1.0), children=(switch,)))


def serving_region(pos: Vector) -> Primitive:
    """Builds the red serving region, 1 mm proud of the table. A visual geom: robosuite hides sites of task objects."""
    slab = Geom("box", (0.07, 0.10, 0.001), (0.0, 0.0, 0.022), rgba=(0.8, 0.05, 0.05, 1.0), role="visual")
    return Primitive("serving_region", Body("main", (slab,), pos))
