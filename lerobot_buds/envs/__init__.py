"""The robosuite tasks as LeRobot environments, and in Gymnasium's registry.

Importing this loads neither LeRobot nor the simulator.
"""

from .loading import open_playback
from .registration import env_id, register_tasks
from .rendering import PROFILES, RenderProfile, profile_named
from .robosuite_env import ACTION_NAMES, CAMERAS, FPS, REACH, STATE_NAMES, EnvSettings, Observation, RobosuiteEnv
from .tasks import STAGE_FACTS, STOCK_TASKS, TASKS, Task, tasks_named
from .vector_env import EpisodeVectorEnv
from .view import SimulationView

__all__ = [
    "ACTION_NAMES",
    "CAMERAS",
    "FPS",
    "PROFILES",
    "REACH",
    "STAGE_FACTS",
    "STATE_NAMES",
    "STOCK_TASKS",
    "TASKS",
    "EnvSettings",
    "EpisodeVectorEnv",
    "Observation",
    "RenderProfile",
    "RobosuiteEnv",
    "SimulationView",
    "Task",
    "env_id",
    "open_playback",
    "profile_named",
    "register_tasks",
    "tasks_named",
]

register_tasks()
