"""The layout of the original BUDS release, as its ``create_demonstration_dataset.py`` writes it.

``data/ep_N/{actions, joint_states, ...}``. The images of all episodes lie one after another, channels first, in
``data/agentview_images`` and ``data/eye_in_hand_images``. Observation j is the one *after* action j.
"""

import h5py

from lerobot_buds.envs import STATE_NAMES

from .layout import Layout


def _fits(_data: h5py.Group, demonstration: h5py.Group) -> bool:
    return str(demonstration.name).rpartition("/")[2].startswith("ep_")


BUDS = Layout(
    name="buds",
    fits=_fits,
    prefix="ep_",
    group="",
    cameras={"agentview": "agentview_images", "eye_in_hand": "eye_in_hand_images"},
    state=("joint_states", "gripper_states", "proprio_states"),
    names={
        "joint_states": STATE_NAMES[:7],
        "gripper_states": STATE_NAMES[7:9],
        "proprio_states": STATE_NAMES[9:],
    },
    leading={"proprio_states": 3},  # the hand's position; behind it the fingers again, or the hand's rotation
    pooled=True,
    late=True,
)
