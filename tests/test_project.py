"""What holds for the project as a whole: the lock file, the wheel, the cost of importing, the size of the code."""

import ast
import re
import subprocess
import sys
import tomllib
from email.parser import Parser
from pathlib import Path
from urllib.parse import urlsplit
from zipfile import ZipFile

import pytest
from packaging.tags import sys_tags
from packaging.utils import parse_wheel_filename

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
SOURCES = [*sorted((ROOT / "lerobot_buds").rglob("*.py")), ROOT / "lerobot_policy_buds.py"]
MODULES = [pytest.param(path, id=str(path.relative_to(ROOT))) for path in SOURCES]


@pytest.fixture(scope="module")
def locked() -> list[dict]:
    """The locked packages, less this one."""
    packages = tomllib.loads((ROOT / "uv.lock").read_text())["package"]
    return [package for package in packages if package["name"] != "lerobot-policy-buds"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> ZipFile:
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (path,) = folder.glob("*.whl")
    return ZipFile(path)


def test_the_lock_file_holds_for_everybody(locked: list[dict]) -> None:
    """One registry with a public address: no password, no port, no file of the machine that locked."""
    (source,) = {tuple(package["source"].items()) for package in locked}
    ((kind, registry),) = source
    assert kind == "registry"
    files = [file for package in locked for file in [*package.get("wheels", ()), package.get("sdist")] if file]
    for url in {registry, *(file["url"] for file in files)}:
        parts = urlsplit(url)
        assert (parts.scheme, parts.username, parts.password, parts.port) == ("https", None, None, None), url
        # Neither an address nor a name of a local network: those have no top-level domain in letters.
        assert re.fullmatch(r"([a-z0-9-]+\.)+[a-z]{2,}", parts.hostname or ""), url
        assert not str(parts.hostname).endswith((".local", ".internal", ".lan", ".localhost", ".localdomain")), url
    assert len({urlsplit(file["url"]).hostname for file in files}) == 1
    assert all(file["hash"].startswith("sha256:") for file in files)


def test_nothing_locked_has_to_be_compiled(locked: list[dict]) -> None:
    ours = set(sys_tags())

    def fits(url: str) -> bool:
        return not ours.isdisjoint(parse_wheel_filename(url.rsplit("/", 1)[-1].replace("%2B", "+"))[3])

    assert [p["name"] for p in locked if not any(fits(file["url"]) for file in p.get("wheels", ()))] == []


def test_there_is_one_opencv(locked: list[dict]) -> None:
    assert [p["name"] for p in locked if p["name"].startswith("opencv")] == ["opencv-python-headless"]


def test_the_wheel_holds_the_package_and_its_entry_point(wheel: ZipFile) -> None:
    names = set(wheel.namelist())
    assert {str(path.relative_to(ROOT)) for path in SOURCES} <= names
    assert "lerobot_buds/py.typed" in names
    assert {f"lerobot_buds/report/page/report.{kind}" for kind in ("html.j2", "css", "js")} <= names
    assert {f"lerobot_buds/teleoperation/web/page.{kind}" for kind in ("html.j2", "css", "js")} <= names
    top_level = {name.split("/")[0] for name in names}
    assert top_level == {"lerobot_buds", "lerobot_policy_buds.py", "lerobot_policy_buds-0.1.0.dist-info"}


def test_the_metadata_keep_the_underscores_that_discovery_needs(wheel: ZipFile) -> None:
    text = wheel.read("lerobot_policy_buds-0.1.0.dist-info/METADATA").decode()
    metadata = Parser().parsestr(text)
    assert metadata["Name"] == "lerobot_policy_buds"
    assert "sim" in metadata.get_all("Provides-Extra")
    assert not any(r.startswith(("robosuite", "opencv-python ")) for r in metadata.get_all("Requires-Dist"))


def test_every_console_script_has_its_function(wheel: ZipFile) -> None:
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    for target in scripts.values():
        module, function = target.split(":")
        tree = ast.parse(wheel.read(module.replace(".", "/") + ".py"))
        assert any(isinstance(node, ast.FunctionDef) and node.name == function for node in tree.body), target


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("lerobot_buds", {"lerobot", "mujoco", "robosuite", "sklearn", "torch"}),
        ("lerobot_buds.evaluation", {"av", "lerobot", "matplotlib", "mujoco", "robosuite", "torch"}),
        ("lerobot_policy_buds", {"mujoco", "robosuite", "sklearn", "matplotlib.pyplot"}),
    ],
)
def test_importing_stays_cheap(module: str, heavy: set[str]) -> None:
    script = f"import sys, {module}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert heavy.isdisjoint(done.stdout.split())


HEAVY = {"av", "datasets", "h5py", "lerobot", "matplotlib", "pandas", "pyarrow", "scipy", "sklearn", "torch"}
ANSWER = """
import importlib, sys
from contextlib import suppress
for target in sys.argv[2:]:
    module, function = target.split(":")
    sys.argv = [target, sys.argv[1]]
    with suppress(SystemExit):
        getattr(importlib.import_module(module), function)()
print("loaded", *sys.modules)
"""


@pytest.mark.parametrize("option", ["--help", "--hepl"])
def test_an_answer_about_options_waits_for_nothing_heavy(option: str) -> None:
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    del scripts["lerobot-buds-rollout"]  # its settings hold LeRobot's own of an environment
    command = [sys.executable, "-c", ANSWER, option, *scripts.values()]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    answer, _, loaded = done.stdout.rpartition("loaded ")
    assert (answer + done.stderr).count("usage: ") == len(scripts)
    assert HEAVY.isdisjoint(loaded.split())


@pytest.mark.parametrize("path", MODULES)
def test_public_code_is_documented(path: Path) -> None:
    tree = ast.parse(path.read_text())
    assert [name for name, node in public(tree, "module") if not ast.get_docstring(node)] == []


@pytest.mark.parametrize("path", MODULES)
def test_code_comes_in_small_pieces(path: Path) -> None:
    text = path.read_text()
    functions = [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    assert len(text.splitlines()) <= 400
    assert [f.name for f in functions if f.end_lineno - f.lineno + 1 > 60] == []


def public(node: ast.Module | ast.ClassDef, name: str):
    """Yields the module, its public classes and functions, and the public methods of those classes."""
    yield name, node
    for child in node.body:
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and not child.name.startswith("_"):
            overload = any(isinstance(d, ast.Name) and d.id in ("overload", "override") for d in child.decorator_list)
            if isinstance(child, ast.ClassDef):
                yield from public(child, child.name)
            elif not overload and not is_setter(child):
                yield child.name, child


def is_setter(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    return any(isinstance(d, ast.Attribute) and d.attr == "setter" for d in function.decorator_list)
