"""Loads the simulator at first use, and says in one line what is missing where that fails."""

import logging
import os
import platform
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING

from lerobot_buds.core import ConfigError, SimulatorError, near_names

from .remedies import STARTING_ERRORS, cannot_start
from .rendering import profile_named
from .tasks import STAGE_FACTS, Task

if TYPE_CHECKING:
    from .simulation.playback import ModelPlayback
    from .simulation.renderer import CameraRenderer
    from .simulation.stock import StockEnv
    from .simulation.tabletop import TabletopEnv

ROBOSUITE_VERSION = "1.5.1"
MUJOCO_RANGE = ((3, 6), (3, 10))
"""MuJoCo versions, from the first up to but without the second, whose bindings robosuite 1.5.1 can use."""

_LOADING = Lock()  # held while the simulator is imported, under a variable of the whole process

_INSTALL = f"pip install 'lerobot_policy_buds[sim]' && pip install --no-deps robosuite=={ROBOSUITE_VERSION}"


def check_versions(robosuite: str | None, mujoco: str | None) -> None:
    """Refuses a missing simulator or one of an unsupported version.

    Args:
        robosuite: Installed version, or None.
        mujoco: Installed version, or None.

    Raises:
        SimulatorError: With the command that mends it.
    """
    if robosuite is None or mujoco is None:
        missing = "robosuite" if robosuite is None else "mujoco"
        raise SimulatorError(f"The simulator is not installed ({missing} is missing). Run: {_INSTALL}")
    if robosuite != ROBOSUITE_VERSION:
        raise SimulatorError(f"robosuite {robosuite} is not supported, only {ROBOSUITE_VERSION} is. Run: {_INSTALL}")
    release = tuple(int(part) for part in mujoco.split(".")[:2])
    low, high = MUJOCO_RANGE
    if not low <= release < high:
        raise SimulatorError(
            f"mujoco {mujoco} is not supported: robosuite {ROBOSUITE_VERSION} needs >= {low[0]}.{low[1]} and "
            f"< {high[0]}.{high[1]}. Run: pip install 'mujoco>={low[0]}.{low[1]},<{high[0]}.{high[1]}'"
        )


def installed_version(distribution: str) -> str | None:
    """Reads the version of an installed distribution, None where it is not installed."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


@contextmanager
def importing_simulator() -> Iterator[None]:
    """Surrounds the imports of what needs MuJoCo or robosuite, which are made at first use, by any thread.

    Raises:
        SimulatorError: The simulator is missing, unsupported, or cannot be loaded here; the message says why.
    """
    check_versions(installed_version("robosuite"), installed_version("mujoco"))
    with _LOADING:
        asked = os.environ.get("MUJOCO_GL")
        if not asked and platform.system() == "Linux":
            asked = os.environ["MUJOCO_GL"] = "egl"  # MuJoCo reads this once, when it is imported
        # At import robosuite warns about optional packages that nothing here uses.
        logging.getLogger("robosuite_logs").addFilter(_is_error)
        try:
            yield
        except STARTING_ERRORS as error:
            raise cannot_start(error) from error
        finally:
            if asked:  # robosuite writes over it, and worker processes inherit it
                os.environ["MUJOCO_GL"] = asked


def open_simulation(task: Task) -> "TabletopEnv | StockEnv":
    """Builds the robosuite environment of a task.

    Raises:
        SimulatorError: The simulator is missing, unsupported, or cannot be loaded here.
        ConfigError: The task has a scene that is not there, or needs a fact that its scene does not tell.
    """
    with importing_simulator():
        from .simulation.scenes import build_scene
        from .simulation.stock import StockEnv
        from .simulation.tabletop import TabletopEnv
    if task.stock:
        return StockEnv(task.name)
    simulation = TabletopEnv(build_scene(task))
    told = simulation.facts()
    for fact in (*task.goal, *(STAGE_FACTS[stage] for stage in task.stages)):
        if fact not in told:
            raise ConfigError(
                f"Task {task.name} needs the fact {fact!r}, which its scene does not tell. {near_names(fact, told)}"
            )
    return simulation


def open_renderer(simulation: "TabletopEnv | StockEnv", profile: str, size: int) -> "CameraRenderer":
    """Makes the renderer of a simulation, for the process and thread that calls.

    Raises:
        SimulatorError: OpenGL cannot draw without a display here.
    """
    from .simulation.renderer import CameraRenderer

    sim = simulation.sim
    return CameraRenderer(sim.model._model, sim.data._data, profile_named(profile), size)


def open_playback(xml: str, folders: Sequence[Path], origin: str) -> "ModelPlayback":
    """Loads a model that somebody saved with demonstrations, to play their states back.

    Args:
        xml: The model's text.
        folders: Where its meshes and textures are searched before the installed robosuite.
        origin: Where the model is from, for messages.

    Raises:
        SimulatorError: The simulator is missing, unsupported, or cannot load its OpenGL library.
        DatasetError: The model does not load here.
    """
    with importing_simulator():
        from .simulation.playback import ModelPlayback
    return ModelPlayback(xml, folders, origin)


def _is_error(record: logging.LogRecord) -> bool:
    return record.levelno >= logging.ERROR
