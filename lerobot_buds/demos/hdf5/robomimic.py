"""robomimic's layout (``dataset_states_to_obs.py``), and its relatives RoboCasa and MimicGen.

``data/demo_N/actions`` and ``data/demo_N/obs/<array>``. Observation t is the one that action t followed; images are
upright. Files of states and vectors alone ("low_dim") have no images.

RoboCasa names three cameras otherwise. MimicGen adds ``demo_N/datagen_info/subtask_term_signals/<name>``: 0 until a
subtask is done, 1 from then on, which tells the true stages.
"""

from dataclasses import replace

import h5py
import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import DatasetError
from lerobot_buds.envs import STATE_NAMES

from .layout import Layout, Stages

_SIGNALS = "datagen_info/subtask_term_signals"
_ROBOCASA_CAMERAS = {
    "agentview_left": "robot0_agentview_left_image",
    "agentview_right": "robot0_agentview_right_image",
    "eye_in_hand": "robot0_eye_in_hand_image",
}
LAST_STAGE = "to_the_end"
"""Name of what follows the last subtask that has a signal."""


def subtask_stages(data: h5py.Group, demonstrations: list[str]) -> Stages:
    """Reads the true stages from the signals that end subtasks.

    A subtask ends, and the next one begins, in the first frame whose signal has gone from 0 to 1. Stages are numbered
    in the order in which subtasks end on average; one that ends in none of the demonstrations is no stage.

    Args:
        data: The group of all demonstrations.
        demonstrations: Names of those to read.

    Raises:
        DatasetError: Signals are missing, or are no numbers by the row.
    """
    ends = {name: _ends(data[name]) for name in demonstrations}
    signals = sorted({signal for found in ends.values() for signal in found})
    place = {s: float(np.mean([found[s] for found in ends.values() if s in found])) for s in signals}
    order = sorted(signals, key=lambda signal: place[signal])
    stages: dict[str, NDArray[np.int64]] = {}
    for name, found in ends.items():
        stages[name] = np.full(len(data[name]["actions"]), len(order), dtype=np.int64)
        begin = 0
        for end, signal in sorted((end, signal) for signal, end in found.items()):
            stages[name][begin:end], begin = order.index(signal), end
    return Stages((*order, LAST_STAGE), stages)


def _ends(demonstration: h5py.Group) -> dict[str, int]:
    group = demonstration.get(_SIGNALS)
    if not isinstance(group, h5py.Group):
        raise DatasetError(
            f"{demonstration.file.filename}: {demonstration.name} has no {_SIGNALS}, as other demonstrations have. "
            "Leave it out with --filter_key, or import without stages: --layout=robomimic."
        )
    ends = {}
    for name, signal in group.items():
        rises = np.flatnonzero(np.diff(_column(signal, len(demonstration["actions"]))) > 0)
        if len(rises):
            ends[name] = int(rises[0]) + 1
    return ends


def _column(signal: h5py.Dataset | h5py.Group, length: int) -> NDArray[np.int64]:
    if not isinstance(signal, h5py.Dataset) or signal.dtype.kind not in "fiub" or signal.size != length:
        raise DatasetError(
            f"{signal.file.filename}: {signal.name} is no signal of {length} rows of 0 or 1. Repair the file, or "
            "import without stages: --layout=robomimic."
        )
    column: NDArray[np.int64] = (signal[()].reshape(-1) > 0.5).astype(np.int64)
    return column


def _has_observations(_data: h5py.Group, demonstration: h5py.Group) -> bool:
    return "obs" in demonstration


def _of_robocasa(_data: h5py.Group, demonstration: h5py.Group) -> bool:
    observations = demonstration.get("obs")
    return isinstance(observations, h5py.Group) and _ROBOCASA_CAMERAS["agentview_left"] in observations


def _of_mimicgen(_data: h5py.Group, demonstration: h5py.Group) -> bool:
    return "obs" in demonstration and _SIGNALS in demonstration


ROBOMIMIC = Layout(
    name="robomimic",
    fits=_has_observations,
    cameras={"agentview": "agentview_image", "eye_in_hand": "robot0_eye_in_hand_image"},
    state=("robot0_joint_pos", "robot0_gripper_qpos", "robot0_eef_pos"),
    names={
        "robot0_joint_pos": STATE_NAMES[:7],
        "robot0_gripper_qpos": STATE_NAMES[7:9],
        "robot0_eef_pos": STATE_NAMES[9:],
    },
)
ROBOCASA = replace(ROBOMIMIC, name="robocasa", fits=_of_robocasa, cameras=_ROBOCASA_CAMERAS)
MIMICGEN = replace(ROBOMIMIC, name="mimicgen", fits=_of_mimicgen, stages=subtask_stages)
