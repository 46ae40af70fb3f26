"""Plays stored simulator states back in their own model: what the robot felt, and what cameras would have seen."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import DatasetError, near_names
from lerobot_buds.envs.rendering import RenderProfile

from .assets import port_model
from .renderer import CameraRenderer

_GRIP_SITE = "grip_site"


class ModelPlayback:
    """A model that is put into one stored state after another.

    Args:
        xml: The model's text.
        folders: Where its meshes and textures are searched before the installed robosuite.
        origin: Where the model is from, for messages.

    Attributes:
        changes: What was changed to load the model, a sentence each.
        joints: Names of the joints that are actuated, in the model's order.
        hands: Names of the sites between the fingertips.
        free_bodies: Names of the bodies that move freely.
        cameras: Names of the model's cameras.
        state_size: Numbers in a stored state: time, positions, velocities.

    Raises:
        DatasetError: The model does not load here.
    """

    def __init__(self, xml: str, folders: Sequence[Path], origin: str) -> None:
        ported = port_model(xml, folders, origin)
        self.changes, self._origin = ported.changes, origin
        try:
            self._model: Any = mujoco.MjModel.from_xml_string(ported.xml)
        except ValueError as error:
            reason = " ".join(str(error).split())
            raise DatasetError(f"{origin}: MuJoCo {mujoco.__version__} cannot load the model: {reason}.") from error
        self._data: Any = mujoco.MjData(self._model)
        self._renderers: dict[tuple[RenderProfile, int], CameraRenderer] = {}
        kinds = self._model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
        self._joints = sorted(set(self._model.actuator_trnid[kinds, 0].tolist()))
        sites = [self._model.site(number).name for number in range(self._model.nsite)]
        self.joints = [str(self._model.joint(number).name) for number in self._joints]
        self.hands = [name for name in sites if name.endswith(_GRIP_SITE)]
        free = np.flatnonzero(self._model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).tolist()
        self._free = {str(self._model.body(self._model.jnt_bodyid[number]).name): number for number in free}
        self.free_bodies = list(self._free)
        self.cameras = [str(self._model.camera(number).name) for number in range(self._model.ncam)]
        self.state_size = 1 + int(self._model.nq) + int(self._model.nv)

    def joint_positions(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """Reads the actuated joints (rad or m), ``(T, J)``, from stored states ``(T, S)``."""
        addresses = self._model.jnt_qposadr[self._joints]
        positions: NDArray[np.float64] = states[:, 1 + addresses]
        return positions

    def body_positions(self, states: NDArray[np.float64], body: str) -> NDArray[np.float64]:
        """Reads where a free body is in the world (m), ``(T, 3)``, from stored states ``(T, S)``."""
        address = 1 + int(self._model.jnt_qposadr[self._free[body]])
        return states[:, address : address + 3]

    def play(
        self, states: NDArray[np.float64], cameras: Mapping[str, str], profile: RenderProfile, size: int
    ) -> tuple[NDArray[np.float64], dict[str, NDArray[np.uint8]]]:
        """Puts the model into states, one after another.

        Args:
            states: ``(T, S)`` time, positions and velocities.
            cameras: Name of the images -> camera of the model.
            profile: What to draw.
            size: Height and width of the images (pixels).

        Returns:
            The hands' positions in the world (m), ``(T, 3 H)``, and the images by name, ``(T, size, size, 3)``.

        Raises:
            DatasetError: The states are not this model's, or it has no such camera.
            SimulatorError: OpenGL cannot draw without a display here.
        """
        self._check(states, cameras)
        hands: NDArray[np.float64] = np.empty((len(states), 3 * len(self.hands)))
        images: dict[str, NDArray[np.uint8]] = {
            name: np.empty((len(states), size, size, 3), dtype=np.uint8) for name in cameras
        }
        renderer = self._renderer(profile, size) if cameras else None
        split = 1 + self._model.nq
        for t, state in enumerate(states):
            self._data.time, self._data.qpos[:], self._data.qvel[:] = state[0], state[1:split], state[split:]
            mujoco.mj_forward(self._model, self._data)
            hands[t] = np.ravel([self._data.site(name).xpos for name in self.hands])
            for name, camera in cameras.items():
                assert renderer is not None
                images[name][t] = renderer.render(camera)
        return hands, images

    def close(self) -> None:
        """Frees what draws."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()

    def _renderer(self, profile: RenderProfile, size: int) -> CameraRenderer:
        if (profile, size) not in self._renderers:
            self._renderers[profile, size] = CameraRenderer(self._model, self._data, profile, size)
        return self._renderers[profile, size]

    def _check(self, states: NDArray[np.float64], cameras: Mapping[str, str]) -> None:
        if states.ndim != 2 or states.shape[1] != self.state_size:
            raise DatasetError(
                f"{self._origin}: states of shape {states.shape} are not of its model, whose states have "
                f"{self.state_size} numbers: time, {self._model.nq} positions, {self._model.nv} velocities."
            )
        for camera in cameras.values():
            if camera not in self.cameras:
                raise DatasetError(
                    f"{self._origin}: the model has no camera {camera!r}. {near_names(camera, self.cameras)}"
                )
