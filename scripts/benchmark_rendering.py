"""Times rendered control steps: ours by profile, in one process and in workers, against robosuite's own cameras.

Two cameras of 128 x 128 pixels, random actions, all in one run: quote the ratios, not the absolute figures.

    python scripts/benchmark_rendering.py
"""

import os
import time
from collections.abc import Callable

import numpy as np

os.environ.setdefault("MUJOCO_GL", "egl")

import robosuite

from lerobot_buds.envs import PROFILES, EnvSettings, EpisodeVectorEnv, RobosuiteEnv

TASK = "multitask_kitchen/task3_variant1"
STEPS, WARM_UP = 60, 5


def steps_per_second(step: Callable[[], object], envs: int = 1) -> float:
    """Times a step function after a warm-up."""
    for _ in range(WARM_UP):
        step()
    began = time.perf_counter()
    for _ in range(STEPS):
        step()
    return envs * STEPS / (time.perf_counter() - began)


def robosuite_cameras() -> float:
    """Times robosuite's own Lift with its own camera observations, all settings at their defaults."""
    env = robosuite.make(
        "Lift",
        robots="Panda",
        has_renderer=False,
        has_offscreen_renderer=True,
        use_camera_obs=True,
        camera_names=["agentview", "robot0_eye_in_hand"],
        camera_heights=128,
        camera_widths=128,
        ignore_done=True,
    )
    env.reset()
    rng = np.random.default_rng(0)
    rate = steps_per_second(lambda: env.step(rng.uniform(-0.5, 0.5, env.action_dim)))
    env.close()
    return rate


def single(profile: str) -> float:
    """Times one of our environments."""
    env = RobosuiteEnv(EnvSettings(TASK, render_profile=profile))
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    rate = steps_per_second(lambda: env.step(rng.uniform(-0.5, 0.5, 4).astype(np.float32)))
    env.close()
    return rate


def vector(count: int, in_workers: bool) -> float:
    """Times several environments of the default profile together."""
    envs = EpisodeVectorEnv(EnvSettings(TASK), count, in_workers)
    envs.reset(seed=0)
    rng = np.random.default_rng(0)
    rate = steps_per_second(lambda: envs.step(rng.uniform(-0.5, 0.5, (count, 4)).astype(np.float32)), count)
    envs.close()
    return rate


def main() -> None:
    """Prints one line a setting."""
    reference = robosuite_cameras()
    rates = {f"ours, profile {name}": single(name) for name in PROFILES}
    rates["ours, 2 environments in this process"] = vector(2, in_workers=False)
    rates["ours, 2 environments in workers"] = vector(2, in_workers=True)
    print(f"{'setting':<40}{'steps/s':>9}{'ratio':>8}")
    print(f"{'robosuite Lift, its own cameras':<40}{reference:>9.1f}{1.0:>8.1f}")
    for name, rate in rates.items():
        print(f"{name:<40}{rate:>9.1f}{rate / reference:>8.1f}")


if __name__ == "__main__":
    main()
