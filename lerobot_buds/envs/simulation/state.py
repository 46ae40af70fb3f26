"""Reads and writes the simulation in the task's terms: positions of objects, joints of fixtures, contacts, the hand."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

Vec = NDArray[np.float64]


class SimulationState:
    """View of one robosuite simulation; holds no state of its own but looked-up ids.

    Args:
        sim: robosuite's simulation.
    """

    def __init__(self, sim: Any) -> None:
        self._sim = sim
        self._body_of_geom = {
            geom: sim.model.body_id2name(sim.model.geom_bodyid[geom]).split("_")[0] for geom in range(sim.model.ngeom)
        }
        self._finger_joints = ["gripper0_right_finger_joint1", "gripper0_right_finger_joint2"]
        self._arm_joints = [f"robot0_joint{i}" for i in range(1, 8)]

    @property
    def hand(self) -> Vec:
        """Position of the grip site, the point between the fingertips (m), shape (3,)."""
        site = self._sim.model.site_name2id("gripper0_right_grip_site")
        return np.array(self._sim.data.site_xpos[site])

    @property
    def fingers(self) -> Vec:
        """Positions of the two finger joints (m), shape (2,)."""
        return np.array([self._sim.data.get_joint_qpos(j) for j in self._finger_joints])

    @property
    def arm(self) -> Vec:
        """Positions of the seven arm joints (rad), shape (7,)."""
        return np.array([self._sim.data.get_joint_qpos(j) for j in self._arm_joints])

    def position(self, body: str) -> Vec:
        """Reads where a body's origin is in the world (m), shape (3,).

        Args:
            body: For example ``pot_main`` or ``cabinet_drawer``.
        """
        return np.array(self._sim.data.body_xpos[self._sim.model.body_name2id(body)])

    def point_on(self, body: str, local: Vec) -> Vec:
        """Converts a point from a body's frame to the world (m), shape (3,)."""
        rotation = np.array(self._sim.data.body_xmat[self._sim.model.body_name2id(body)]).reshape(3, 3)
        point: Vec = self.position(body) + rotation @ local
        return point

    def joint(self, name: str) -> float:
        """Reads a hinge (rad) or slide (m) joint, for example ``cabinet_slide``."""
        return float(self._sim.data.get_joint_qpos(name))

    def set_joint(self, name: str, value: float) -> None:
        """Writes a hinge (rad) or slide (m) joint."""
        self._sim.data.set_joint_qpos(name, value)

    def set_pose(self, name: str, pos: Vec, yaw: float, roll: float = 0.0) -> None:
        """Puts a free object somewhere.

        Args:
            name: The object's name, for example ``pot``.
            pos: Position of its origin (m), shape (3,).
            yaw: Rotation about the vertical (rad).
            roll: Rotation about its own x axis before that (rad).
        """
        turn, tilt = (np.cos(yaw / 2), np.sin(yaw / 2)), (np.cos(roll / 2), np.sin(roll / 2))
        quat = np.array([turn[0] * tilt[0], turn[0] * tilt[1], turn[1] * tilt[1], turn[1] * tilt[0]])
        self._sim.data.set_joint_qpos(f"{name}_free", np.concatenate([pos, quat]))

    def touching(self, first: str, second: str) -> bool:
        """Tells whether two objects, given by name, are in contact."""
        wanted = {first, second}
        contacts = self._sim.data.contact
        return any(
            {self._body_of_geom[contacts[i].geom1], self._body_of_geom[contacts[i].geom2]} == wanted
            for i in range(self._sim.data.ncon)
        )

    def show(self, geom: str, visible: bool) -> None:
        """Shows or hides a geom through its opacity."""
        self._sim.model.geom_rgba[self._sim.model.geom_name2id(geom)][3] = float(visible)

    def diverged(self) -> bool:
        """Tells whether MuJoCo met NaN, infinite or huge values since the reset.

        MuJoCo then resets the simulation by itself and goes on, so that finite numbers alone prove nothing.
        """
        bad = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
        return any(self._sim.data.warning[kind].number for kind in bad)
