"""Renders cameras with `mujoco.Renderer`, which makes its own OpenGL context current before it draws.

robosuite's renderer does not: two of its environments in one process draw into each other's images.
"""

import atexit
import os
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_buds.envs.remedies import STARTING_ERRORS, cannot_start, forked
from lerobot_buds.envs.rendering import RenderProfile

_DRAWN, _HIDDEN = 1, 4
_drew_first: int | None = None  # the process that drew first: this one, or one that it was forked from
_ARM_COLOUR = (0.82, 0.82, 0.84, 1.0)
_HAND_COLOUR = (0.25, 0.25, 0.28, 1.0)


class CameraRenderer:
    """Draws the cameras of one simulation.

    It belongs to the process and thread that makes it.

    Args:
        model: MuJoCo's compiled model, whose looks are changed to fit the profile.
        data: MuJoCo's state, which is drawn.
        profile: What to draw.
        size: Height and width of the images (pixels).

    Raises:
        SimulatorError: OpenGL cannot draw without a display here, or in a process that was forked too late.
    """

    def __init__(self, model: Any, data: Any, profile: RenderProfile, size: int) -> None:
        self._model, self._data = model, data
        _apply(profile, self._model, size)
        global _drew_first
        if _drew_first not in (None, os.getpid()):
            raise forked()
        _drew_first = os.getpid()
        try:
            self._renderer = mujoco.Renderer(self._model, height=size, width=size)
        except (*STARTING_ERRORS, mujoco.FatalError) as error:
            raise cannot_start(error) from error
        # Runs before MuJoCo's own handler, which ends EGL under every context that is still there.
        atexit.register(self.close)
        self._options = mujoco.MjvOption()
        self._options.geomgroup[:] = 0
        self._options.geomgroup[_DRAWN] = 1
        self._options.sitegroup[:] = 0

    def render(self, camera: str) -> NDArray[np.uint8]:
        """Draws one camera, top row first.

        Args:
            camera: A camera's name in the model.

        Returns:
            ``(H, W, 3)`` uint8 RGB.
        """
        self._renderer.update_scene(self._data, camera=camera, scene_option=self._options)
        image: NDArray[np.uint8] = self._renderer.render()
        return image

    def close(self) -> None:
        """Frees the OpenGL context; may be called twice."""
        atexit.unregister(self.close)
        self._renderer.close()


def _apply(profile: RenderProfile, model: Any, size: int) -> None:
    model.vis.quality.offsamples = profile.multisampling
    screen = model.vis.global_
    screen.offwidth, screen.offheight = max(screen.offwidth, size), max(screen.offheight, size)
    if not profile.reflections:
        model.mat_reflectance[:] = 0.0
    if not profile.collision_meshes:
        return
    for geom in range(model.ngeom):
        body = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, model.geom_bodyid[geom])
        if not body.startswith(("robot0_", "gripper0_", "fixed_mount0_")):
            continue
        collides = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
        model.geom_group[geom] = _DRAWN if collides else _HIDDEN
        if collides:
            model.geom_matid[geom] = -1
            model.geom_rgba[geom] = _HAND_COLOUR if body.startswith("gripper0_") else _ARM_COLOUR
