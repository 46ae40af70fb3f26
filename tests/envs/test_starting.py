"""A simulator that cannot start: the true cause and a remedy that works, from the doctor and from a command alike.

Every fault is really provoked. MuJoCo, robosuite and numba read their settings when they are imported: hence a process
each.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

DOCTOR = """
from lerobot_buds.cli.doctor import check_rendering, this_installation
finding = check_rendering(this_installation())
print(finding.status, finding.detail, '->', finding.remedy)
"""
COMMAND = """
from lerobot_buds.core import SimulatorError
from lerobot_buds.envs import EnvSettings, RobosuiteEnv
try:
    RobosuiteEnv(EnvSettings('Lift', image_size=32)).reset(seed=0)
except SimulatorError as error:
    print(error)
"""
SETTINGS = (
    "CUDA_VISIBLE_DEVICES",
    "DISPLAY",
    "MUJOCO_EGL_DEVICE_ID",
    "MUJOCO_GL",
    "PYOPENGL_PLATFORM",
    "WAYLAND_DISPLAY",
)
NO_CACHE = {
    "NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator"
}  # as where nothing but NUMBA_CACHE_DIR may be written
FAULTS = {
    "invisible device": (
        {"CUDA_VISIBLE_DEVICES": "1", "MUJOCO_EGL_DEVICE_ID": "0"},
        "MUJOCO_EGL_DEVICE_ID=0 names no device that may draw here, with CUDA_VISIBLE_DEVICES='1'",
        "unset MUJOCO_EGL_DEVICE_ID",
    ),
    "no device": ({"MUJOCO_EGL_DEVICE_ID": "gpu"}, "MUJOCO_EGL_DEVICE_ID=gpu names", "unset MUJOCO_EGL_DEVICE_ID"),
    "no cache": (NO_CACHE, "numba finds no folder", "set NUMBA_CACHE_DIR to a folder that can be written"),
    "no display": ({"MUJOCO_GL": "glfw"}, "which has no display (DISPLAY unset)", "set MUJOCO_GL=egl"),
    "drawing off": ({"MUJOCO_GL": "off"}, "MUJOCO_GL='off' turns drawing off", "set MUJOCO_GL=egl"),
    "no backend": ({"MUJOCO_GL": "crayons"}, "MuJoCo has no backend", "set MUJOCO_GL=egl"),
    "two minds": ({"PYOPENGL_PLATFORM": "osmesa"}, "contradicts MUJOCO_GL='egl'", "unset PYOPENGL_PLATFORM"),
}


def said(code: str, **settings: str) -> str:
    environment = {name: value for name, value in os.environ.items() if name not in SETTINGS} | settings
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_has_its_cause_and_its_remedy(fault: str) -> None:
    settings, cause, remedy = FAULTS[fault]
    finding = said(DOCTOR, **settings)
    assert finding.startswith("FAIL") and finding.count("\n") == 1
    assert cause in finding.partition("->")[0] and remedy in finding.partition("->")[2]


def test_a_command_says_what_the_doctor_says() -> None:
    settings, cause, remedy = FAULTS["invisible device"]
    message = said(COMMAND, **settings)
    assert message.startswith("The simulator cannot start: ") and cause in message and remedy in message


def test_the_remedies_work(tmp_path: Path) -> None:
    """All at once: the device unset, the cache set, and the backend that is advised."""
    settings = {"CUDA_VISIBLE_DEVICES": "1", "MUJOCO_GL": "egl", "NUMBA_CACHE_DIR": str(tmp_path)} | NO_CACHE
    assert said(DOCTOR, **settings).startswith("ok drew 64x64 pixels with MUJOCO_GL=egl")
    assert any(tmp_path.iterdir())
