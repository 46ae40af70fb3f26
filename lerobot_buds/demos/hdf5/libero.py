"""LIBERO's layout (its ``create_dataset.py``; LOTUS reads the same): one file a task, which says what it does.

``data/demo_N/obs/<array>`` as robomimic has it, but the observation is taken *after* the action of its row, and images
are upside down where ``macros_image_convention`` is "opengl". LeRobot turns the images of its LIBERO environment by 180
degrees, not upside down, so that left and right are exchanged; so do the datasets that go with it, and so do we.
"""

import h5py

from lerobot_buds.envs import STATE_NAMES

from .layout import Layout

_CONVENTION = "macros_image_convention"


def _fits(data: h5py.Group, demonstration: h5py.Group) -> bool:
    observations = demonstration.get("obs")
    named = isinstance(observations, h5py.Group) and "agentview_rgb" in observations
    return "obs" in demonstration and ("bddl_file_name" in data.attrs or _CONVENTION in data.attrs or named)


def _orientation(data: h5py.Group) -> str | None:
    return {"opengl": "rotated", "opencv": "stored"}.get(str(data.attrs.get(_CONVENTION)))


LIBERO = Layout(
    name="libero",
    fits=_fits,
    cameras={"agentview": "agentview_rgb", "eye_in_hand": "eye_in_hand_rgb"},
    # What LeRobot's LIBERO environment gives, in its order.
    state=("ee_pos", "ee_ori", "gripper_states"),
    names={
        "ee_pos": STATE_NAMES[9:],
        "ee_ori": ["eef_axisangle_x", "eef_axisangle_y", "eef_axisangle_z"],
        "gripper_states": STATE_NAMES[7:9],
        "joint_states": STATE_NAMES[:7],
    },
    late=True,
    orientation=_orientation,
)
