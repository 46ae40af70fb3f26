"""Renders one frame, to find out whether the simulator can draw on this machine at all."""

import os
from ctypes import ArgumentError

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import SimulatorError

# What MuJoCo's import ends in: no driver or no such backend, no libEGL, no libOpenGL, a library that does not load.
_LOADING_ERRORS = (ImportError, RuntimeError, AttributeError, ArgumentError, OSError)

SCENE = '<mujoco><worldbody><geom type="sphere" size="0.3"/></worldbody></mujoco>'


def render_frame(size: int = 64) -> NDArray[np.uint8]:
    """Draws a grey sphere on black with the OpenGL backend that ``MUJOCO_GL`` names, EGL where it names none.

    Args:
        size: Width and height of the image (pixels).

    Returns:
        ``(size, size, 3)`` uint8 image, RGB.

    Raises:
        SimulatorError: MuJoCo is missing, finds no OpenGL driver, or draws nothing but black.
    """
    backend = os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        import mujoco
    except _LOADING_ERRORS as error:
        raise SimulatorError(f"MuJoCo cannot be loaded with MUJOCO_GL={backend}: {error}") from error
    try:
        model = mujoco.MjModel.from_xml_string(SCENE)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        with mujoco.Renderer(model, size, size) as renderer:
            renderer.update_scene(data)
            frame: NDArray[np.uint8] = renderer.render()
    except (*_LOADING_ERRORS, mujoco.FatalError) as error:
        raise SimulatorError(f"MuJoCo cannot render with MUJOCO_GL={backend}: {error}") from error
    if not frame.any():
        raise SimulatorError(f"MuJoCo renders nothing but black with MUJOCO_GL={backend}.")
    return frame
