"""Says why the simulator cannot start here and what mends that, which the libraries' own messages seldom do."""

import os
import sys
from ctypes import ArgumentError

from lerobot_buds.core import SimulatorError

# What loading the simulator or opening OpenGL ends in: a missing library as PyOpenGL reports it (the first four), a
# backend or device that MuJoCo does not know, and robosuite's check of the device.
STARTING_ERRORS = (AttributeError, ImportError, OSError, ArgumentError, RuntimeError, ValueError, AssertionError)

_TURNED_OFF = ("disable", "disabled", "off", "false", "0")


class CannotStartError(SimulatorError):
    """The simulator cannot be loaded, or cannot draw.

    Made of its message alone, as every error that has to come back from a worker process is.

    Attributes:
        cause: What is in its way.
        remedy: What to do about it.
    """

    cause = remedy = ""

    @classmethod
    def of(cls, cause: str, remedy: str) -> "CannotStartError":
        """Makes the error that says both."""
        error = cls(f"The simulator cannot start: {cause}. To mend it, {remedy}.")
        error.cause, error.remedy = cause, remedy
        return error


def cannot_start(error: Exception) -> CannotStartError:
    """Tells the cause from what a library raised and from what the environment variables ask for.

    Args:
        error: One of `STARTING_ERRORS`, or MuJoCo's own error.
    """
    said = " ".join(str(error).split()).rstrip(".")
    for told in (_numba, _device, _backend_setting):
        if (found := told(said)) is not None:
            return CannotStartError.of(*found)
    return CannotStartError.of(f"OpenGL cannot be used with {_setting('MUJOCO_GL')} ({said})", _library())


def forked() -> CannotStartError:
    """Tells that this process was forked from one that had drawn: OpenGL would wait for threads that are not there."""
    return CannotStartError.of(
        "this process was forked from one that had already drawn, which OpenGL does not survive",
        "have the workers started in another way, for example by gymnasium.make_vec(..., vector_kwargs={'context': "
        "'forkserver'}), or start them before anything is drawn",
    )


def backend() -> str:
    """Names the OpenGL backend that MuJoCo has taken, or that it is asked for where it could take none."""
    # What was decided when MuJoCo was imported; robosuite may have written over the variable since.
    context = getattr(sys.modules.get("mujoco"), "GLContext", None)
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    return context.__module__.rpartition(".")[2] if context is not None else asked


def _numba(said: str) -> tuple[str, str] | None:
    if "cannot cache function" not in said:
        return None
    cause = f"numba finds no folder to keep what it compiles, with {_setting('NUMBA_CACHE_DIR')} ({said})"
    return cause, "set NUMBA_CACHE_DIR to a folder that can be written"


def _device(said: str) -> tuple[str, str] | None:
    device = os.environ.get("MUJOCO_EGL_DEVICE_ID")
    if device is None or ("MUJOCO_EGL_DEVICE_ID" not in said and repr(device) not in said):
        return None
    visible = _setting("CUDA_VISIBLE_DEVICES")
    cause = f"MUJOCO_EGL_DEVICE_ID={device} names no device that may draw here, with {visible} ({said})"
    return cause, "unset MUJOCO_EGL_DEVICE_ID, or let it name a device that exists and is visible"


def _backend_setting(said: str) -> tuple[str, str] | None:
    taken, platform = backend(), os.environ.get("PYOPENGL_PLATFORM", "").lower()
    setting, use_egl = _setting("MUJOCO_GL"), "set MUJOCO_GL=egl before Python starts"
    if "invalid value for environment variable MUJOCO_GL" in said:
        return f"MuJoCo has no backend of the name in {setting}", use_egl
    if taken in _TURNED_OFF:
        return f"{setting} turns drawing off", use_egl
    if taken == "glfw":
        return f"MuJoCo draws through GLFW, with {setting}, which has no display ({_setting('DISPLAY')})", use_egl
    if taken in ("egl", "osmesa") and platform not in ("", taken):
        return f"{_setting('PYOPENGL_PLATFORM')} contradicts {setting}", "unset PYOPENGL_PLATFORM"
    return None


def _library() -> str:
    if backend() == "osmesa":
        return "install OSMesa (Debian: apt-get install libosmesa6), or set MUJOCO_GL=egl"
    return (
        "install OpenGL (Debian: apt-get install libegl1 libgl1-mesa-dri libopengl0), or install libosmesa6 and set "
        "MUJOCO_GL=osmesa"
    )


def _setting(variable: str) -> str:
    value = os.environ.get(variable)
    return f"{variable} unset" if value is None else f"{variable}={value!r}"
