"""What MkDocs is told beside the pages of docs/: a hook, see mkdocs.yml.

The start page is README.md, and every package whose `__init__` lists public names has a page of reference. A page that
shows less than these names fails the build.
"""

import ast
import logging
import os
import re
from pathlib import Path, PurePosixPath
from typing import Any

ROOT = Path(__file__).parents[1]

COPIES = {
    "index.md": "README.md",
    "examples.md": "examples/README.md",
    "contributing.md": "CONTRIBUTING.md",
    "conduct.md": "CODE_OF_CONDUCT.md",
    "changelog.md": "CHANGELOG.md",
}
"""Page of the site -> the file of the checkout that is shown there."""

BESIDE = {
    "envs": ["lerobot_buds.envs.configuration_robosuite.RobosuiteEnvConfig"],
    "teleoperation": [
        "lerobot_buds.teleoperation.config_robosuite_sim.RobosuiteSimConfig",
        "lerobot_buds.teleoperation.robosuite_sim.RobosuiteSim",
        "lerobot_buds.teleoperation.config_robosuite_hand.RobosuiteHandConfig",
        "lerobot_buds.teleoperation.robosuite_hand.RobosuiteHand",
    ],
    "policy": ["lerobot_buds.policy.modeling_buds.BudsPolicy"],
    "cli": [
        "lerobot_buds.cli.collect.CollectConfig",
        "lerobot_buds.cli.import_hdf5.ImportConfig",
        "lerobot_buds.cli.segment.SegmentConfig",
        "lerobot_buds.cli.compare.CompareConfig",
        "lerobot_buds.cli.diagnose.DiagnoseConfig",
        "lerobot_buds.cli.rollout.RolloutConfig",
    ],
}
"""Folder -> what users meet although the folder does not import it, since that would load torch or LeRobot."""

_GOAL = r"\((?!https?:|mailto:|#)([^)#\s]+)(#[^)\s]*)?\)"
_IMAGE = re.compile(r"(!\[[^][]*\])" + _GOAL)
_LINK = re.compile(r"(?<!!)\[((?:[^][]|!\[[^][]*\]\([^)]*\))*)\]" + _GOAL)

logger = logging.getLogger("mkdocs.hooks.docs_site")


def public_names() -> dict[str, list[str]]:
    """Reads which names every package makes public: dotted name -> its `__all__`, from the sources alone."""
    found = {}
    for path in sorted((ROOT / "lerobot_buds").rglob("__init__.py")):
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.Assign) and any(
                isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets
            ):
                found[".".join(path.parent.relative_to(ROOT).parts)] = ast.literal_eval(node.value)
    return found


def reference_pages() -> dict[str, str]:
    """Writes the pages of reference, one a folder of the package: what it is, then every public name."""
    names = public_names()
    pages: dict[str, str] = {}
    for folder in sorted({package.split(".")[1] for package in names} | BESIDE.keys()):
        parts = [f"# lerobot_buds.{folder}", _directive(f"lerobot_buds.{folder}", members="false")]
        for package in (package for package in names if package.split(".")[1] == folder):
            if package.count(".") > 1:
                parts += [f"## {package}", _directive(package, members="false")]
            parts += [_directive(place_of(package, name), **_SHOWN) for name in names[package]]
        parts += [_directive(name, **_SHOWN) for name in BESIDE.get(folder, ())]
        pages[f"api/{folder}.md"] = "\n\n".join(parts) + "\n"
    return pages


_SHOWN = {"show_root_heading": "true", "show_root_toc_entry": "true"}


def _directive(name: str, **options: str) -> str:
    return "\n".join([f"::: {name}", "    options:", *(f"      {key}: {value}" for key, value in options.items())])


def place_of(package: str, name: str) -> str:
    """Tells under which dotted name a public name is found: where it is its module's too, that hides it."""
    hidden = (ROOT.joinpath(*package.split(".")) / f"{name}.py").is_file()
    return f"{package}.{name}.{name}" if hidden else f"{package}.{name}"


def copied_page(source: str, repository: str = "") -> str:
    """Reads a file of the checkout as a page of the site, with links that lead where they did.

    Args:
        source: The file, from the root of the checkout.
        repository: Address of the repository, for links to what is no page; without it only their text is left.
    """
    pages = {file: page for page, file in COPIES.items()}

    def place(target: str) -> str | None:
        path = os.path.normpath(PurePosixPath(source).parent / target)
        if path in pages or path.startswith("docs/"):
            return pages.get(path, path.removeprefix("docs/"))
        return f"{repository.rstrip('/')}/blob/main/{path}" if repository else None

    def image(match: re.Match[str]) -> str:
        return f"{match[1]}({place(match[2]) or match[2]})"

    def link(match: re.Match[str]) -> str:
        to = place(match[2])
        return match[1] if to is None else f"[{match[1]}]({to}{match[3] or ''})"

    text = (ROOT / source).read_text().replace('src="docs/', 'src="')
    return _LINK.sub(link, _IMAGE.sub(image, text))


def on_files(files: Any, config: Any) -> Any:
    """Adds the pages that docs/ does not hold."""
    from mkdocs.structure.files import File

    copies = {page: copied_page(source, config.repo_url or "") for page, source in COPIES.items()}
    for page, text in {**copies, **reference_pages()}.items():
        files.append(File.generated(config, page, content=text))
    return files


def on_post_build(config: Any) -> None:
    """Warns, which ends a strict build, of every public name that the reference does not show."""
    for package, names in public_names().items():
        page = Path(config.site_dir) / "api" / package.split(".")[1] / "index.html"
        shown = set(re.findall(r'id="([\w.]+)"', page.read_text()))
        for name in names:
            if place_of(package, name) not in shown:
                logger.warning("%s.%s is public, but %s does not show it.", package, name, page)
