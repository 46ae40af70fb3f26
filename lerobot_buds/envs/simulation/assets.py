"""Makes models that others saved loadable here: files by their base name, and spellings that MuJoCo has given up."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import robosuite

from lerobot_buds.core import DatasetError

_BRACKETS = re.compile(r"\[([^\[\]]*)\]")


@dataclass
class PortedModel:
    """A model that can be compiled here.

    Attributes:
        xml: Its text.
        changes: What was changed beyond the place of its files, a sentence each.
    """

    xml: str
    changes: list[str] = field(default_factory=list)


def port_model(xml: str, folders: Sequence[Path], origin: str) -> PortedModel:
    """Points a model's meshes and textures to files of this machine.

    Of several files of one name the first folder counts, and in it the one whose path is most like the model's. A mesh
    that no folder holds is left out where nothing but looks depends on it.

    Args:
        xml: The model, with the paths of the machine that saved it.
        folders: Folders to search, most important first; the installed robosuite's own are searched last.
        origin: Where the model is from, for messages.

    Raises:
        DatasetError: The text is no XML, or files are missing that shapes depend on (all are named).
    """
    try:
        root = ElementTree.fromstring(xml)
    except ElementTree.ParseError as error:
        raise DatasetError(f"{origin}: the model is damaged ({error}); fetch the file again.") from error
    ported = PortedModel("")
    _unbracket(root, ported)
    index = [_index(folder) for folder in (*folders, Path(robosuite.__file__).parent / "models" / "assets")]
    missing = {}
    for element in root.iter():
        path = element.get("file")
        if path is None or element.tag not in ("mesh", "texture"):
            continue
        found = _find(path, index)
        if found is None:
            missing[path] = element
            continue
        element.set("file", str(found))
        if element.tag == "texture":
            _flatten(element, found, ported)
    _leave_out(root, missing, ported, origin)
    ported.xml = ElementTree.tostring(root, encoding="unicode")
    return ported


def _unbracket(root: Element, ported: PortedModel) -> None:
    """Writes ``[0, 0, 1]``, which MuJoCo read once, as ``0 0 1``."""
    rewritten = []
    for element in root.iter():
        for name, value in element.items():
            if match := _BRACKETS.fullmatch(value.strip()):
                element.set(name, match[1].replace(",", " "))
                rewritten.append(f"{name}={value!r}")
    if rewritten:
        ported.changes.append(f"read without brackets: {len(rewritten)} attributes such as {rewritten[0]}")


def _index(folder: Path) -> dict[str, list[Path]]:
    index: dict[str, list[Path]] = {}
    for path in sorted(folder.rglob("*")):
        index.setdefault(path.name.lower(), []).append(path)
    return index


def _find(path: str, index: list[dict[str, list[Path]]]) -> Path | None:
    wanted = PurePosixPath(path.replace("\\", "/"))
    for names in index:
        if candidates := names.get(wanted.name.lower()):
            parts = {part.lower() for part in wanted.parts}
            return max(candidates, key=lambda found: len(parts.intersection(part.lower() for part in found.parts)))
    return None


def _flatten(texture: Element, path: Path, ported: PortedModel) -> None:
    """Makes a cube texture flat whose image, exchanged by a later robosuite, is no longer square."""
    from PIL import Image

    if texture.get("type", "cube") == "cube" and texture.get("gridsize") is None:
        with Image.open(path) as image:
            width, height = image.size
        if width != height and height != 6 * width:
            texture.set("type", "2d")
            ported.changes.append(f"texture {path.name} is {width} x {height} pixels and wraps no cube: drawn flat")


def _leave_out(root: Element, missing: dict[str, Element], ported: PortedModel, origin: str) -> None:
    """Removes meshes that are missing with the geoms that only show them; refuses where they do more."""
    names = {element.get("name") or PurePosixPath(path).stem: path for path, element in missing.items()}
    solid = {
        names[geom.get("mesh", "")]
        for geom in root.iter("geom")
        if geom.get("mesh") in names and not (geom.get("contype") == geom.get("conaffinity") == "0")
    }
    solid |= {path for path, element in missing.items() if element.tag == "texture"}
    if solid:
        listing = ", ".join(sorted(PurePosixPath(path).name for path in solid))
        raise DatasetError(
            f"{origin}: the installed robosuite lacks {len(solid)} file(s) of the model: {listing}. Name the folder "
            "models/assets of the robosuite that recorded it with --assets."
        )
    for parent in list(root.iter()):
        for child in list(parent):
            if child in missing.values() or (child.tag == "geom" and child.get("mesh") in names):
                parent.remove(child)
    if names:
        listing = ", ".join(sorted(PurePosixPath(path).name for path in names.values()))
        ported.changes.append(
            f"meshes that only show are not here and not drawn (--assets names their folder): {listing}"
        )
