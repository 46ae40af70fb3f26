"""How fast control steps are simulated and drawn: ours by profile, against robosuite with its own cameras.

Each in a process of its own: where another OpenGL context was used before, robosuite's images take a tenth of the time.
"""

import time
from collections.abc import Callable, Iterator

import numpy as np

from lerobot_buds.envs import EnvSettings, EpisodeVectorEnv, RobosuiteEnv

from .figures import Figure, Setting, alone

TASK = "multitask_kitchen/task3_variant1"
WARM_UP = 5
THEIRS = "robosuite's Lift, its own cameras"


def measure(setting: Setting) -> Iterator[Figure]:
    """Takes random actions, two cameras of the paper's pixels each."""
    steps, pixels = setting.size.steps, setting.size.pixels
    yield Figure(THEIRS, alone(_robosuite, steps, pixels), "steps/s")
    yield Figure("ours without images", alone(_single, "fastest", steps, pixels, draws=False), "steps/s", THEIRS)
    for profile in setting.size.profiles:
        yield Figure(f"ours, profile {profile}", alone(_single, profile, steps, pixels), "steps/s", THEIRS)
    for place, in_workers in (("one process", False), ("workers", True)):
        rate = alone(_vector, 2, steps, pixels, in_workers)
        yield Figure(f"ours, 2 environments in {place}", rate, "steps/s", THEIRS)


def _steps_per_second(step: Callable[[], object], steps: int, envs: int = 1) -> float:
    for _ in range(WARM_UP):
        step()
    began = time.perf_counter()
    for _ in range(steps):
        step()
    return envs * steps / (time.perf_counter() - began)


def _robosuite(steps: int, pixels: int) -> float:
    """Times robosuite's own Lift with its own camera observations, all other settings at their defaults."""
    import robosuite

    env = robosuite.make(
        "Lift",
        robots="Panda",
        has_renderer=False,
        has_offscreen_renderer=True,
        use_camera_obs=True,
        camera_names=["agentview", "robot0_eye_in_hand"],
        camera_heights=pixels,
        camera_widths=pixels,
        ignore_done=True,
    )
    env.reset()
    rng = np.random.default_rng(0)
    rate = _steps_per_second(lambda: env.step(rng.uniform(-0.5, 0.5, env.action_dim)), steps)
    env.close()
    return rate


def _single(profile: str, steps: int, pixels: int, draws: bool = True) -> float:
    env = RobosuiteEnv(EnvSettings(TASK, image_size=pixels, render_profile=profile, draws=draws))
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    rate = _steps_per_second(lambda: env.step(rng.uniform(-0.5, 0.5, 4).astype(np.float32)), steps)
    env.close()
    return rate


def _vector(count: int, steps: int, pixels: int, in_workers: bool) -> float:
    envs = EpisodeVectorEnv(EnvSettings(TASK, image_size=pixels), count, in_workers)
    envs.reset(seed=0)
    rng = np.random.default_rng(0)
    rate = _steps_per_second(lambda: envs.step(rng.uniform(-0.5, 0.5, (count, 4)).astype(np.float32)), steps, count)
    envs.close()
    return rate
