"""robosuite's own tasks behind the same wrapper."""

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from lerobot_buds.envs import STOCK_TASKS, EnvSettings, RobosuiteEnv


@pytest.mark.parametrize("task", ["Lift", "Stack", "NutAssemblySquare", "PickPlaceCan", "Door"])
def test_a_seed_decides_the_start_and_the_global_generator_stays_alone(task):
    env = RobosuiteEnv(EnvSettings(task, None, 32, "fastest"))

    def start(seed):
        env.reset(seed=seed)
        return np.array(env.simulation.sim.data.qpos)

    before = np.random.get_state()[1].copy()  # noqa: NPY002
    first, other, again = start(3), start(4), start(3)
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    observation, _, success, _, info = env.step(np.array([0.5, 0.0, 0.0, -1.0], dtype=np.float32))
    assert not success and info["is_success"] is False and len(info["stages_done"]) == 0
    assert min(image.std() for image in observation["pixels"].values()) > 10  # something is to be seen
    env.close()


def test_gymnasium_accepts_one():
    env = RobosuiteEnv(EnvSettings("Lift", None, 32, "fastest"))
    check_env(env, skip_render_check=True)
    env.close()


def test_lift_can_be_done():
    env = RobosuiteEnv(EnvSettings("Lift", None, 16, draws=False))
    env.reset(seed=0)
    success = False
    for step in range(120):
        cube = env.state.position("cube_main")
        above = np.array([0.0, 0.0, 0.02 if step < 40 else 0.0])
        target = cube + above if step < 80 else env.state.hand + np.array([0.0, 0.0, 0.05])
        closed = 1.0 if step > 65 else -1.0
        aim = np.clip((target - env.state.hand) / 0.05, -1, 1)
        success = env.step(np.append(aim, closed).astype(np.float32))[2]
        if success:
            break
    assert success
    env.close()


def test_every_stock_task_has_a_description():
    assert all(task.description and task.stock and not task.stages for task in STOCK_TASKS.values())
