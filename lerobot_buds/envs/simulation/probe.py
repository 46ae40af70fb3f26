"""Renders one frame, to find out whether the simulator can draw on this machine at all."""

import os

import numpy as np
from numpy.typing import NDArray

from ...core import SimulatorError

SCENE = '<mujoco><worldbody><geom type="sphere" size="0.3"/></worldbody></mujoco>'
REMEDY = "install libegl1 and libgl1-mesa-dri (apt-get), or set MUJOCO_GL=osmesa and install libosmesa6"


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

        model = mujoco.MjModel.from_xml_string(SCENE)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        with mujoco.Renderer(model, size, size) as renderer:
            renderer.update_scene(data)
            frame: NDArray[np.uint8] = renderer.render()
    # No library, no driver and no such backend each end in another of these.
    except (ImportError, AttributeError, OSError, RuntimeError) as error:
        raise SimulatorError(f"MuJoCo cannot render with MUJOCO_GL={backend} ({error}): {REMEDY}.") from error
    if not frame.any():
        raise SimulatorError(f"MuJoCo renders only black images with MUJOCO_GL={backend}: {REMEDY}.")
    return frame
