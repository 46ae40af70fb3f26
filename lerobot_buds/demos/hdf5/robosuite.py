"""robosuite's own recordings (``collect_human_demonstrations.py``): simulator states, played back and drawn here.

``data/demo_N/{states, actions}`` and the attribute ``model_file``: the text of the scene's XML, or (robosuite before
1.4) the name of a file in ``models/`` beside the HDF5 file. State t is the one that action t followed. robosuite 0.3
stored the joint velocities and the gripper's command in place of ``actions``, in steps that are not equally long.
"""

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import ACTION, IMAGE_PREFIX, STATE, ConfigError, DatasetError, sha256_of_json
from lerobot_buds.envs import ACTION_NAMES, STATE_NAMES, open_playback, profile_named

from .clock import Clock, resampled
from .layout import STATES, Layout, data_of
from .rows import Rows, require_arrays, selected_names
from .source import Source
from .stored import names_of, read_rows, require_finite_rows
from .told import told_by

if TYPE_CHECKING:
    from lerobot_buds.envs.simulation.playback import ModelPlayback

logger = logging.getLogger(__name__)

_MODEL = "model_file"
_OLD_ACTIONS = ("joint_velocities", "gripper_actuations")
_EYES_IN_HAND = ("robot0_eye_in_hand", "eye_in_hand")
_PANDA_JOINTS = [f"joint{n}" for n in range(1, 8)]


def _fits(_data: h5py.Group, demonstration: h5py.Group) -> bool:
    return STATES in demonstration and _MODEL in demonstration.attrs


ROBOSUITE = Layout(
    name="robosuite",
    fits=_fits,
    group="",
    cameras={"agentview": "agentview", "eye_in_hand": _EYES_IN_HAND[0]},
    state=(),
    names={},
)


class PlayedDemonstrations:
    """The demonstrations of an open file of simulator states; see `Demonstrations`.

    The state is that of the actuated joints, and behind it the position of the point between the fingertips in the
    world. A Panda's has the names of our own environments, any other robot's those of its model's joints.

    Args:
        file: The file, open for reading.
        source: What to read of it.

    Raises:
        ConfigError: A setting does not go with the layout.
        DatasetError: Arrays are missing (all are named), of unequal lengths, or not finite; the model is missing or
            does not load; the steps are not equally long and nothing was said about that.
        SimulatorError: The simulator is missing or unsupported.
    """

    layout = ROBOSUITE.name
    stages: tuple[str, ...] = ()

    def __init__(self, file: h5py.File, source: Source) -> None:
        if source.state or source.orientation:
            raise ConfigError(
                "state and orientation are those of the simulator in the robosuite layout: leave both out, but for "
                "--state=[], which imports none."
            )
        self._source, self._data = source, data_of(file, source.path)
        self._profile = profile_named(source.render_profile)
        names = selected_names(file, ROBOSUITE, source)
        self._actions = self._action_arrays(file, names)
        self._states = {name: self._checked(name) for name in names}
        told = told_by(self._data, names, source)
        clock = Clock.of(self._states, told.fps, source)
        self._picked = {name: resampled(states[:, 0], source.resample) for name, states in self._states.items()}
        self.fps = source.resample or clock.fps
        self.environment, self.instructions = told.environment, told.instructions
        self.lengths = {name: len(rows) for name, rows in self._picked.items()}
        self._model: tuple[str, ModelPlayback] | None = None
        model = self._playback(names[0])
        self._cameras = self._choose_cameras(model)
        self.state_names = [] if source.state is not None else _state_names(model)
        first = [self._action_part(names[0], key) for key in self._actions]
        keys = ["action"] if len(first) == 1 else self._actions
        usual = ACTION_NAMES if len(first) == 1 else None
        self.action_names = [n for key, part in zip(keys, first, strict=True) for n in names_of(key, usual, part)]
        for name in names:
            require_finite_rows(self._action(name), self.action_names, f"{source.path}: {ACTION!r}", name)
        size = source.image_size
        self.image_shapes: dict[str, tuple[int, ...]] = {
            IMAGE_PREFIX + camera: (size, size, 3) for camera in self._cameras
        }
        self.facts: dict[str, Any] = {
            "clock": clock.facts,
            "model_changes": model.changes,
            # Models may lie beside the file, whose own hash knows nothing of them.
            "models_sha256": sha256_of_json([self._model_text(name) for name in names]),
        }

    def read(self, name: str) -> dict[str, NDArray[Any]]:
        """Plays one demonstration back; see `Demonstrations.read`."""
        rows, model = self._picked[name], self._playback(name)
        states = self._states[name][rows]
        hands, images = model.play(states, self._cameras, self._profile, self._source.image_size)
        columns: dict[str, NDArray[Any]] = {IMAGE_PREFIX + camera: frames for camera, frames in images.items()}
        columns[ACTION] = self._action(name)[rows]
        if self.state_names:
            columns[STATE] = np.hstack([model.joint_positions(states), hands]).astype(np.float32)
            if columns[STATE].shape[1] != len(self.state_names):
                raise DatasetError(
                    f"{self._source.path}: the model of {name} has other joints than that of the first demonstration; "
                    "import them apart with --filter_key."
                )
        return columns

    def bodies(self, name: str) -> dict[str, NDArray[np.float64]]:
        """Reads where things are: truth that a policy does not see and a dataset does not hold.

        Args:
            name: Name of a demonstration, a key of `lengths`.

        Returns:
            Position in the world (m) of every body that moves freely, ``(T, 3)`` by its name.
        """
        model, states = self._playback(name), self._states[name][self._picked[name]]
        return {body: model.body_positions(states, body) for body in model.free_bodies}

    def close(self) -> None:
        """Frees what draws."""
        if self._model is not None:
            self._model[1].close()
            self._model = None

    def _action_arrays(self, file: h5py.File, names: list[str]) -> list[str]:
        first = self._data[names[0]]
        old = ACTION + "s" not in first and all(key in first for key in _OLD_ACTIONS)
        keys = list(_OLD_ACTIONS) if old else [ACTION + "s"]
        require_arrays(
            file, self.layout, self._source, [f"data/{name}/{key}" for name in names for key in (STATES, *keys)]
        )
        if old:
            logger.info("%s: actions are the stored joint velocities and the gripper's command.", self._source.path)
        return keys

    def _checked(self, name: str) -> NDArray[np.float64]:
        arrays = {key: self._data[name][key] for key in (STATES, *self._actions)}
        length = len(arrays[STATES])
        for array in arrays.values():
            if array.ndim != 2 or array.dtype.kind not in "fiu" or len(array) != length or not length:
                raise DatasetError(
                    f"{self._source.path}: {array.name} is of type {array.dtype} and shape {array.shape}, but {name} "
                    f"has {length} states; wanted are as many rows of numbers. Fetch the file again, or repair it."
                )
        states: NDArray[np.float64] = self._read(name, STATES).astype(np.float64)
        names = [f"number {n}" for n in range(states.shape[1])]
        require_finite_rows(states, names, f"{self._source.path}: {STATES!r}", name)
        return states

    def _read(self, name: str, key: str) -> NDArray[Any]:
        array = self._data[name][key]
        return read_rows(Rows(array, 0, len(array)), self._source)

    def _action_part(self, name: str, key: str) -> NDArray[np.float32]:
        return self._read(name, key).astype(np.float32)

    def _action(self, name: str) -> NDArray[np.float32]:
        return np.hstack([self._action_part(name, key) for key in self._actions])

    def _playback(self, name: str) -> "ModelPlayback":
        """Loads the model of a demonstration, unless it is the one of the demonstration before."""
        text = self._model_text(name)
        if self._model is None or self._model[0] != text:
            if self._model is not None:
                self._model[1].close()
            folders = [] if self._source.assets is None else [self._source.assets]
            self._model = (text, open_playback(text, folders, f"{self._source.path}, {name}"))
            for change in self._model[1].changes:
                logger.warning("%s, %s: %s", self._source.path, name, change)
        return self._model[1]

    def _model_text(self, name: str) -> str:
        attribute = self._data[name].attrs.get(_MODEL)
        text = attribute.decode() if isinstance(attribute, bytes) else str(attribute or "")
        if text.lstrip().startswith("<"):
            return text
        path = self._source.path.parent / "models" / Path(text).name
        if not text or not path.is_file():
            raise DatasetError(
                f"{self._source.path}: the model of {name} is missing (attribute {_MODEL}={text!r}, looked for in "
                f"{path.parent}). Fetch the folder models/ that belongs to the file."
            )
        return path.read_text(encoding="utf-8")

    def _choose_cameras(self, model: "ModelPlayback") -> dict[str, str]:
        if self._source.cameras is not None:
            unknown = [camera for camera in self._source.cameras.values() if camera not in model.cameras]
            if unknown:
                raise DatasetError(f"{self._source.path}: its scenes have no cameras {unknown}, only {model.cameras}.")
            return dict(self._source.cameras)
        eye = next((camera for camera in _EYES_IN_HAND if camera in model.cameras), None)
        if eye is None or ROBOSUITE.cameras["agentview"] not in model.cameras:
            raise DatasetError(
                f"{self._source.path}: its scenes have the cameras {model.cameras}, not agentview and an eye in hand. "
                "Choose some, as in --cameras='{front: frontview}'."
            )
        return {"agentview": ROBOSUITE.cameras["agentview"], "eye_in_hand": eye}


def _state_names(model: "ModelPlayback") -> list[str]:
    short = [name.removeprefix("robot0_").removeprefix("gripper0_") for name in model.joints]
    names = [f"{name}.pos" for name in (short if len(set(short)) == len(short) else model.joints)]
    if short[:7] == _PANDA_JOINTS and ["finger_joint" in name for name in short[7:]] in ([], [True, True]):
        names = STATE_NAMES[: len(short)]
    if len(model.hands) == 1:
        return names + STATE_NAMES[9:]
    return names + [f"{hand}_{axis}.pos" for hand in model.hands for axis in "xyz"]
