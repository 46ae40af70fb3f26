"""A bundle is whole or absent, holds what a node lacks, and robosuite without its other robots does for every scene."""

import csv
import io
import os
import re
import runpy
import subprocess
import sys
import tarfile
import tomllib
from base64 import urlsafe_b64encode
from hashlib import sha256
from importlib.metadata import files
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest
from packaging.tags import compatible_tags, cpython_tags
from packaging.utils import parse_wheel_filename

from lerobot_buds.core import BudsError, ConfigError, read_json

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
SCRIPT = runpy.run_path(str(ROOT / "scripts/offline_bundle.py"))
Config = SCRIPT["BundleConfig"]

# One task of every scene, and of robosuite's own all that differ in what they load.
SCENES = ["tool_use/full", "hammer_place/full", "kitchen/full", "multitask_kitchen/task3_variant1", "real_kitchen/full"]
STOCK = ["Lift", "Stack", "NutAssembly", "PickPlace", "Door"]


@pytest.fixture(scope="module")
def locked() -> dict[str, str]:
    return dict(SCRIPT["locked_requirements"](ROOT))


def test_a_node_with_torch_gets_what_it_lacks(locked: dict[str, str]) -> None:
    chosen = SCRIPT["choose"](locked, Config(Path("x")))
    assert {"lerobot", "mujoco", "robosuite", "ruptures", "numpy", "torchvision", "torchcodec", "sympy"} <= set(chosen)
    assert not [name for name in chosen if re.match(r"(torch|triton|nvidia-.*|cuda-.*|pytest|ruff|uv|timm)$", name)]
    assert re.match(r"robosuite==1\.5\.1 .*--hash=sha256:[0-9a-f]{64}", chosen["robosuite"], re.DOTALL)


def test_torch_comes_along_and_others_stay_where_that_is_asked_for(locked: dict[str, str]) -> None:
    chosen = SCRIPT["choose"](locked, Config(Path("x"), with_torch=True, leave_out=["cmake"]))
    assert {"torch", "triton", "nvidia-nccl-cu13", "cuda-bindings"} <= set(chosen)
    assert set(locked) - set(chosen) == {"cmake"}
    with pytest.raises(ConfigError, match=r"'cmaek'.*Did you mean 'cmake'"):
        SCRIPT["choose"](locked, Config(Path("x"), leave_out=["cmaek"]))


def test_every_package_has_a_wheel_for_the_nodes(locked: dict[str, str]) -> None:
    tags = {*cpython_tags((3, 12), platforms=SCRIPT["PLATFORMS"])}
    tags |= {*compatible_tags((3, 12), "cp312", SCRIPT["PLATFORMS"])}
    packages = {p["name"]: p for p in tomllib.loads((ROOT / "uv.lock").read_text())["package"]}
    for name in locked:
        wheels = [wheel["url"].rsplit("/")[-1].replace("%2B", "+") for wheel in packages[name]["wheels"]]
        assert any(not tags.isdisjoint(parse_wheel_filename(wheel)[3]) for wheel in wheels), name


def test_a_slimmed_wheel_is_a_valid_one(tmp_path: Path) -> None:
    full, info, assets = tmp_path / "robosuite-1.5.1-py3-none-any.whl", "robosuite-1.5.1.dist-info", SCRIPT["ASSETS"]
    kept = ["robosuite/__init__.py", f"{assets}robots/panda/robot.xml", f"{assets}textures/metal.png", f"{info}/WHEEL"]
    with ZipFile(full, "w") as wheel:
        for name in [*kept, f"{assets}robots/ur5e/robot.xml", f"{assets}bullet_data/panda.urdf", f"{info}/RECORD"]:
            wheel.writestr(name, f"content of {name}\n")
    slim = SCRIPT["slim_wheel"](full)
    assert str(parse_wheel_filename(slim.name)[1]) == "1.5.1" and parse_wheel_filename(slim.name)[2] == (1, "slim")
    with ZipFile(slim) as wheel:
        assert wheel.namelist() == [*kept, f"{info}/RECORD"]
        assert wheel.read(f"{info}/WHEEL").endswith(b"\nBuild: 1slim\n")
        for name, digest, size in list(csv.reader(io.StringIO(wheel.read(f"{info}/RECORD").decode())))[:-1]:
            content = wheel.read(name)
            found = urlsafe_b64encode(sha256(content).digest()).rstrip(b"=").decode()
            assert (digest, size) == (f"sha256={found}", str(len(content)))


def test_every_scene_starts_with_what_is_left_of_robosuite(tmp_path: Path) -> None:
    installed = [file for file in files("robosuite") or () if file.parts[0] == "robosuite" and file.suffix != ".pyc"]
    used = [file for file in installed if SCRIPT["is_used"](str(file))]
    assert sum(file.locate().stat().st_size for file in used) < 70 << 20
    for file in used:
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).symlink_to(file.locate())
    program = f"""
import robosuite
assert robosuite.__file__.startswith({str(tmp_path)!r}), robosuite.__file__
from lerobot_buds.envs import tasks_named
from lerobot_buds.envs.loading import open_simulation
for task in tasks_named({",".join([*SCENES, *STOCK])!r}):
    open_simulation(task).close()  # MuJoCo reads every mesh and texture when it compiles the model
"""
    # Compiling robosuite's functions anew for this place takes longer than running them as they are.
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}:{ROOT}", "NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, "-c", program], env=environment, check=True)


@pytest.fixture
def content(tmp_path: Path) -> dict[str, Path]:
    folder = tmp_path / "content"
    folder.mkdir()
    (folder / "noise").write_bytes(bytes(range(256)) * 99)
    (folder / "empty").touch()
    return {"recordings/serve": folder}


def test_joined_parts_are_what_was_written(content: dict[str, Path], tmp_path: Path) -> None:
    joined = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        SCRIPT["write_parts"](content, tmp_path / name, 1000, 12345)
        parts = sorted((tmp_path / name).iterdir())
        assert [p.name for p in parts[:2]] == ["part.0000", "part.0001"]
        assert {p.stat().st_size for p in parts[:-1]} == {1000} and 0 < parts[-1].stat().st_size <= 1000
        joined.append(b"".join(p.read_bytes() for p in parts))
    assert joined[0] == joined[1]
    with tarfile.open(fileobj=io.BytesIO(joined[0])) as tar:
        assert {(m.uid, m.gid, m.uname, m.gname, m.mtime) for m in tar} == {(0, 0, "", "", 12345)}
        tar.extractall(tmp_path / "out", filter="data")
    for file in ("noise", "empty"):
        assert (tmp_path / "out/recordings/serve" / file).read_bytes() == (
            content["recordings/serve"] / file
        ).read_bytes()


@pytest.mark.parametrize("damage", ["changed", "missing", "not carried at all"])
def test_a_damaged_bundle_is_not_installed(damage: str, content: dict[str, Path], tmp_path: Path) -> None:
    bundle = tmp_path / "bundle"
    bundle.mkdir()
    SCRIPT["write_parts"](content, bundle, 9000, 0)
    (bundle / "install.sh").write_text(SCRIPT["INSTALLER"].read_text())
    SCRIPT["write_sums"](bundle)
    part = bundle / "part.0001"
    if damage == "changed":
        part.write_bytes(part.read_bytes()[:-1] + b"!")
    for lost in {"changed": [], "missing": [part]}.get(damage, [*bundle.glob("part.*")]):
        lost.unlink()
    environment = os.environ | {"PYTHON": sys.executable}
    command = ["bash", str(bundle / "install.sh"), str(tmp_path / "folder")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "damaged or not whole" in done.stderr
    assert list((tmp_path / "folder").iterdir()) == []


def without_downloads(monkeypatch: pytest.MonkeyPatch, collect: Any) -> None:
    monkeypatch.setitem(SCRIPT["bundle"].__globals__, "collect_wheels", collect)


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="a bundle is made from a checkout")
def test_a_bundle_holds_all_and_names_no_place(
    monkeypatch: pytest.MonkeyPatch, content: dict[str, Path], tmp_path: Path
) -> None:
    def collect(requirements: dict[str, str], folder: Path) -> list[Path]:
        folder.mkdir()
        wheels = [
            folder / f"{name}-{v}-py3-none-any.whl" for name, v in (("torchvision", "0.26.0"), ("tqdm", "4.70.1"))
        ]
        for wheel in wheels:
            wheel.touch()
        return wheels

    without_downloads(monkeypatch, collect)
    target = tmp_path / "bundle"
    SCRIPT["bundle"](Config(target, part_mib=1, recordings=[content["recordings/serve"]]))
    names = sorted(path.name for path in target.iterdir() if not path.name.startswith("part."))
    assert names == ["SHA256SUMS", "bundle.json", "install.sh"] and os.access(target / "install.sh", os.X_OK)
    subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=target, check=True)
    assert read_json(target / "bundle.json")["recordings"] == ["recordings/content"]
    with tarfile.open(fileobj=io.BytesIO(b"".join(p.read_bytes() for p in sorted(target.glob("part.*"))))) as tar:
        tar.extractall(tmp_path / "out", filter="data")
    out = tmp_path / "out"
    assert re.fullmatch(r"lerobot-policy-buds==\S+\ntqdm==4\.70\.1\n", (out / "requirements.txt").read_text())
    assert re.fullmatch(r"torch==[0-9.]+\ntorchvision==0\.26\.0\n", (out / "companions.txt").read_text())
    assert (out / "project/scripts/reproduce.py").exists() and (out / "recordings/content/noise").exists()
    assert not [p for p in out.rglob("*") if p.is_file() and str(ROOT).encode() in p.read_bytes()]
    with pytest.raises(ConfigError, match="exists"):
        SCRIPT["bundle"](Config(target))


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="a bundle is made from a checkout")
def test_a_bundle_that_fails_leaves_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def collect(requirements: dict[str, str], folder: Path) -> list[Path]:
        raise BudsError("no network")

    without_downloads(monkeypatch, collect)
    with pytest.raises(BudsError, match="no network"):
        SCRIPT["bundle"](Config(tmp_path / "bundle"))
    assert [path.name for path in tmp_path.iterdir()] == [".bundle.lock"]


def test_recordings_must_be_there_and_have_names_of_their_own(tmp_path: Path) -> None:
    for folder in ("a/serve", "b/serve"):
        (tmp_path / folder).mkdir(parents=True)
    with pytest.raises(ConfigError, match=r"none at .*lost"):
        SCRIPT["bundle"](Config(tmp_path / "bundle", recordings=[tmp_path / "lost"]))
    with pytest.raises(ConfigError, match="same name"):
        SCRIPT["bundle"](Config(tmp_path / "bundle", recordings=[tmp_path / "a/serve", tmp_path / "b/serve"]))
