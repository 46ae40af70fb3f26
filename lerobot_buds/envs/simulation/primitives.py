"""Objects and fixtures built from MuJoCo primitives: no meshes, no XML files.

A `Body` is plain data: geoms, at most one joint, child bodies. `Primitive` turns one into the object that robosuite's
task model wants: every geom becomes a collision geom (group 0) and, unless it is only one of the two, a visual copy
without contacts (group 1).
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field

from robosuite.models.objects import MujocoGeneratedObject
from robosuite.utils.mjcf_utils import CustomMaterial, array_to_string

Vector = tuple[float, ...]

DEFAULT_FRICTION = (1.0, 0.005, 0.0001)
DEFAULT_DENSITY = 1000.0


@dataclass(frozen=True)
class Geom:
    """One primitive shape of a body.

    Attributes:
        kind: MuJoCo type: ``box``, ``cylinder`` or ``capsule``.
        size: Half sizes (m): three for a box, radius and half length otherwise.
        pos: Centre in the body's frame (m).
        material: A key of `MATERIALS`, or None to use `rgba`.
        rgba: Colour where there is no material.
        quat: Orientation (w, x, y, z) in the body's frame.
        density: kg/m^3; ignored where the body states its inertia.
        friction: Sliding, torsional, rolling.
        role: ``both`` collides and is seen, ``visual`` is only seen, ``collision`` only collides.
        name: Needed only by geoms that code refers to.
    """

    kind: str
    size: Vector
    pos: Vector = (0.0, 0.0, 0.0)
    material: str | None = None
    rgba: Vector = (0.5, 0.5, 0.5, 1.0)
    quat: Vector = (1.0, 0.0, 0.0, 0.0)
    density: float = DEFAULT_DENSITY
    friction: Vector = DEFAULT_FRICTION
    role: str = "both"
    name: str = ""


@dataclass(frozen=True)
class Inertia:
    """Stated inertia of a body whose geoms carry none (kg, m, kg m^2)."""

    mass: float
    pos: Vector
    diagonal: Vector
    quat: Vector


@dataclass(frozen=True)
class Body:
    """A rigid body of an object.

    Attributes:
        name: Unique within the object; the outermost body is the object's root.
        geoms: Its shapes.
        pos: Position in the parent's frame (m); the world for the root.
        quat: Orientation (w, x, y, z) in the parent's frame.
        joint: Attributes of its MuJoCo joint, named ``name``; none for a fixed body.
        inertia: Stated inertia; none to infer it from the collision geoms.
        children: Bodies that move with it.
    """

    name: str
    geoms: tuple[Geom, ...]
    pos: Vector = (0.0, 0.0, 0.0)
    quat: Vector = (1.0, 0.0, 0.0, 0.0)
    joint: dict[str, str] | None = None
    inertia: Inertia | None = None
    children: tuple["Body", ...] = field(default=())


FREE_JOINT = {"name": "free", "type": "free", "damping": "0.0005"}

# Name -> (robosuite texture, material attributes), after the original task zoo.
_WOOD = {"texrepeat": "1 1", "specular": "0.4", "shininess": "0.1"}
_GRAIN = {"texrepeat": "3 3", "specular": "0.4", "shininess": "0.1"}
_SHINY = {"specular": "1", "shininess": "0.3", "rgba": "0.9 0.9 0.9 1"}
MATERIALS: dict[str, tuple[str, dict[str, str]]] = {
    "red_wood": ("WoodRed", _WOOD),
    "blue_wood": ("WoodBlue", _WOOD),
    "green_wood": ("WoodGreen", _WOOD),
    "red_grain": ("WoodRed", _GRAIN),
    "bread": ("Bread", _GRAIN),
    "dark_wood": ("WoodDark", _GRAIN),
    "light_wood": ("WoodLight", _GRAIN),
    "steel": ("SteelScratched", _GRAIN),
    "metal": ("Metal", _SHINY),
    "ceramic": ("Ceramic", _SHINY),
}


class Primitive(MujocoGeneratedObject):  # type: ignore[misc]  # robosuite ships no types
    """A robosuite object made from a `Body` tree.

    Args:
        name: Prefix of every element's name: the pot's root body becomes ``pot_main``.
        root: The outermost body. For free objects its joint is `FREE_JOINT`.
    """

    def __init__(self, name: str, root: Body) -> None:
        super().__init__()
        self._name = name
        self._obj = _element_of(root)
        for material in dict.fromkeys(g.material for g in _geoms_of(root) if g.material):
            texture, attributes = MATERIALS[material]
            self.append_material(
                CustomMaterial(
                    texture=texture,
                    tex_name=f"{material}_texture",
                    mat_name=material,
                    tex_attrib={"type": "cube"},
                    mat_attrib=attributes,
                )
            )
        self._get_object_properties()

    def sanity_check(self) -> None:
        """Accepts every body tree; required by robosuite."""

    def _get_object_subtree(self) -> ET.Element:
        return self._obj


def _geoms_of(body: Body) -> Iterator[Geom]:
    yield from body.geoms
    for child in body.children:
        yield from _geoms_of(child)


def _element_of(body: Body) -> ET.Element:
    element = ET.Element("body", name=body.name, pos=array_to_string(body.pos), quat=array_to_string(body.quat))
    if body.joint is not None:
        ET.SubElement(element, "joint", body.joint)
    if body.inertia is not None:
        inertia = body.inertia
        ET.SubElement(
            element,
            "inertial",
            mass=str(inertia.mass),
            pos=array_to_string(inertia.pos),
            diaginertia=array_to_string(inertia.diagonal),
            quat=array_to_string(inertia.quat),
        )
    for number, geom in enumerate(body.geoms):
        _add_geom(element, geom, geom.name or f"{body.name}_g{number}")
    for child in body.children:
        element.append(_element_of(child))
    return element


def _add_geom(parent: ET.Element, geom: Geom, name: str) -> None:
    shape = {
        "type": geom.kind,
        "size": array_to_string(geom.size),
        "pos": array_to_string(geom.pos),
        "quat": array_to_string(geom.quat),
    }
    if geom.role != "visual":
        physics = {"density": str(geom.density), "friction": array_to_string(geom.friction)}
        ET.SubElement(parent, "geom", shape | physics | {"name": name, "group": "0", "rgba": "0.5 0.5 0.5 0"})
    if geom.role != "collision":
        look = {"material": geom.material} if geom.material else {"rgba": array_to_string(geom.rgba)}
        # No mass: inertia comes from the collision geoms alone.
        ghost = {"name": f"{name}_visual", "group": "1", "contype": "0", "conaffinity": "0", "mass": "0"}
        ET.SubElement(parent, "geom", shape | look | ghost)
