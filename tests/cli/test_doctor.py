"""The doctor tells a broken installation from a sound one. Broken ones are described, not produced."""

import importlib
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from lerobot_buds.cli.doctor import (
    CHECKS,
    DISTRIBUTION,
    Installation,
    check_decoder,
    check_discovery,
    check_disk,
    check_lerobot,
    check_opencv,
    check_plugin,
    check_rendering,
    check_simulator,
    check_store,
    check_versions,
    examine,
    this_installation,
)
from lerobot_buds.core import LEROBOT_RANGE, SimulatorError
from lerobot_buds.data import FrameStore
from lerobot_buds.envs.remedies import CannotStartError


def refuse(*modules: str, error: type[Exception] = ImportError):
    """A `load` under which some modules cannot be imported."""

    def load(name: str) -> object:
        if name in modules:
            raise error(f"no {name} here\nand a long story")
        return object()

    return load


def fail_to_render():
    raise CannotStartError.of("no libEGL", "install it")


def lose_the_simulation():
    raise SimulatorError("The simulation diverged.")


SOUND = Installation(
    plugins=["torch", DISTRIBUTION],
    requirements=[
        *("lerobot[training]<0.7,>=0.6.1", "numpy>=2.0", 'mujoco<3.10,>=3.6; extra == "sim"'),
        'ruptures>=1.1.10; extra == "cp"',  # not installed, and not missed
    ],
    versions={"lerobot": "0.6.1", "numpy": "2.2.6", "mujoco": "3.9.0", "robosuite": "1.5.1"},
    opencv_owners=["opencv-python-headless"],
    free_bytes=100 * 2**30,
    load=refuse(),
    registered=lambda: (["act", "buds"], ["pusht", "robosuite"]),
    render=lambda: np.ones((4, 6, 3), np.uint8),
    store=lambda: FrameStore(Path("no such folder"), 2**30),
)


def installed(**versions: str | None) -> Installation:
    changed = {**SOUND.versions, **versions}
    return replace(SOUND, versions={name: version for name, version in changed.items() if version})


def test_a_sound_installation_has_nothing_to_remedy() -> None:
    findings = list(examine(SOUND))
    assert len(findings) == len(CHECKS)
    assert {f.status for f in findings} == {"ok"}
    assert not any(f.remedy for f in findings)


@pytest.mark.parametrize(
    ("check", "installation", "status", "said"),
    [
        (check_discovery, replace(SOUND, plugins=["torch"]), "FAIL", "not installed"),
        (check_discovery, replace(SOUND, plugins=["lerobot-policy-buds"]), "FAIL", "LeRobot skips"),
        (check_lerobot, installed(lerobot="0.7.0"), "warning", "LeRobot 0.7.0 is not among those"),
        (check_lerobot, installed(lerobot="0.6.0"), "warning", "tried with (>=0.6.1,<0.7); it may work"),
        (check_lerobot, installed(lerobot=None), "FAIL", "not installed"),
        (check_versions, installed(numpy="1.26.4"), "FAIL", "numpy 1.26.4 (needs >=2.0)"),
        (check_versions, installed(numpy=None), "FAIL", "numpy is missing"),
        (check_simulator, installed(robosuite=None, mujoco=None), "warning", "not installed"),
        (check_simulator, installed(robosuite="1.5.2"), "FAIL", "robosuite 1.5.2 (needs ==1.5.1)"),
        (check_simulator, installed(mujoco="3.10.0"), "FAIL", "mujoco 3.10.0 (needs <3.10,>=3.6)"),
        (check_simulator, installed(mujoco="3.5.0"), "FAIL", "mujoco 3.5.0"),
        (check_rendering, replace(SOUND, render=fail_to_render), "FAIL", "no libEGL"),
        (check_rendering, replace(SOUND, render=lose_the_simulation), "FAIL", "diverged"),
        (check_rendering, replace(SOUND, render=lambda: np.zeros((4, 6, 3), np.uint8)), "FAIL", "nothing but black"),
        (check_decoder, replace(SOUND, load=refuse("torchcodec.decoders")), "warning", "pyav"),
        (check_decoder, replace(SOUND, load=refuse("torchcodec.decoders", error=RuntimeError)), "warning", "pyav"),
        (check_decoder, replace(SOUND, load=refuse("torchcodec.decoders", "av")), "FAIL", "pyav does not load"),
        (check_opencv, replace(SOUND, opencv_owners=[]), "FAIL", "no distribution"),
        (check_opencv, replace(SOUND, opencv_owners=["opencv-python"]), "FAIL", "opencv-python own"),
        (
            check_opencv,
            replace(SOUND, opencv_owners=["opencv-python-headless", "opencv_python"]),
            "FAIL",
            "opencv-python and opencv-python-headless",
        ),
        (check_disk, replace(SOUND, free_bytes=5 * 2**30), "warning", "5.0 GiB free"),
        (check_disk, replace(SOUND, free_bytes=2**20), "FAIL", "0.0 GiB free"),
        (check_plugin, replace(SOUND, load=refuse(DISTRIBUTION)), "FAIL", "cannot be imported"),
        (check_plugin, replace(SOUND, registered=lambda: (["act"], ["robosuite"])), "FAIL", "policy 'buds'"),
        (check_plugin, replace(SOUND, registered=lambda: (["buds"], ["pusht"])), "FAIL", "environment 'robosuite'"),
    ],
)
def test_a_broken_installation_is_named_in_one_line_with_its_remedy(check, installation, status, said) -> None:
    finding = check(installation)
    assert finding.status == status
    assert said in finding.detail
    assert finding.remedy
    assert "\n" not in str(finding)
    assert str(finding).startswith(status)


def test_the_remedy_keeps_robosuite_from_bringing_a_second_opencv() -> None:
    remedy = check_simulator(installed(robosuite="1.5.2", mujoco="3.10.0")).remedy
    assert remedy == "pip install --no-deps 'robosuite==1.5.1' && pip install 'mujoco<3.10,>=3.6'"


def test_no_remedy_installs_this_package_by_a_name_that_no_index_knows() -> None:
    """An extra of what is installed already may be asked for by name."""
    broken = replace(SOUND, plugins=[], load=refuse(DISTRIBUTION), registered=lambda: ([], []))
    half = replace(SOUND, registered=lambda: ([], []))
    remedies = [check_discovery(broken).remedy, check_plugin(broken).remedy, check_plugin(half).remedy]
    for remedy in remedies:
        assert "in a checkout" in remedy and "once it is published" in remedy
        assert not re.search(rf"pip install[^,(]*{DISTRIBUTION}(?!\[)", remedy)


def test_a_lerobot_that_was_not_tried_is_warned_of_when_the_plugin_is_loaded(caplog, monkeypatch) -> None:
    import lerobot_buds.plugin

    for version, warnings in (("0.6.1", 0), ("0.7.0", 1)):
        caplog.clear()
        monkeypatch.setattr("importlib.metadata.version", lambda name, version=version: version)
        importlib.reload(lerobot_buds.plugin)
        assert len(caplog.messages) == warnings
    assert "LeRobot 0.7.0 is not among those" in caplog.text and "lerobot[training]==0.6.1" in caplog.text


def test_the_range_of_lerobots_is_that_of_the_package() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    (requirement,) = [r for r in map(Requirement, project["dependencies"]) if r.name == "lerobot"]
    assert requirement.specifier == SpecifierSet(LEROBOT_RANGE)


def test_a_fault_inside_the_plugin_is_not_swallowed_and_comes_last() -> None:
    broken = replace(SOUND, load=refuse(DISTRIBUTION, error=ZeroDivisionError))
    findings = examine(broken)
    for _ in CHECKS[:-1]:
        next(findings)
    with pytest.raises(ZeroDivisionError):
        next(findings)


@pytest.mark.parametrize("absent", [{"robosuite": None, "mujoco": None}, {"robosuite": None}])
def test_a_machine_without_the_simulator_does_not_try_to_render(absent) -> None:
    bare = replace(installed(**absent), render=fail_to_render)
    assert check_rendering(bare).status == "ok"


def test_the_running_installation_is_described() -> None:
    installation = this_installation()
    assert installation.versions["lerobot"] == "0.6.1"
    assert any(r.startswith("lerobot[training]") for r in installation.requirements)
    assert list(installation.opencv_owners) == ["opencv-python-headless"]
    assert installation.free_bytes > 0


def test_the_store_of_frames_is_shown_with_its_bound_and_how_to_empty_it(tmp_path, monkeypatch) -> None:
    np.save(tmp_path / "frames.npy", np.ones(2**16))
    small = replace(SOUND, store=lambda: FrameStore(tmp_path, 2**10))
    assert check_store(small).status == "warning" and "BUDS_STORE_LIMIT" in check_store(small).remedy
    large = check_store(replace(SOUND, store=lambda: FrameStore(tmp_path, 2**31)))
    assert large.status == "ok" and f"of at most 2.0 GiB decoded frames in {tmp_path}" in large.detail
    subprocess.run(shlex.split(large.detail.partition("to empty it: ")[2].rstrip(")")), check=True)
    assert FrameStore(tmp_path, 2**31).used_bytes() == 0
    monkeypatch.setenv("BUDS_STORE_LIMIT", "much")
    wrong = check_store(replace(SOUND, store=this_installation().store))
    assert wrong.status == "FAIL" and wrong.remedy == "unset BUDS_STORE_LIMIT"
    assert check_store(replace(SOUND, store=lambda: refuse("lerobot")("lerobot"))).status == "ok"  # said elsewhere


def test_the_doctor_starts_without_lerobot() -> None:
    """A broken LeRobot is what it is to find."""
    code = "import sys; import lerobot_buds.cli.doctor; print('lerobot' in sys.modules)"
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "False\n"
