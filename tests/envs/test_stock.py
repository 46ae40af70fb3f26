"""robosuite's own tasks behind the same wrapper."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.typing import NDArray

from lerobot_buds.envs import STOCK_TASKS, EnvSettings, RobosuiteEnv

pytestmark = pytest.mark.slow


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


def starts(task: str, seeds: range) -> list[NDArray[np.float64]]:
    env = RobosuiteEnv(EnvSettings(task, None, 16, draws=False))
    found = []
    for seed in seeds:
        env.reset(seed=seed)
        found.append(np.array(env.simulation.sim.data.qpos))
    env.close()
    return found


def test_a_seed_decides_the_start_in_threads_too():
    """As lerobot-eval's env.max_parallel_tasks runs them, beside a task of ours, which robosuite draws for as well."""
    tasks, seeds = ("Lift", "Stack", "hammer_place/full"), range(500_000, 500_005)
    alone = {task: starts(task, seeds) for task in tasks}
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    with ThreadPoolExecutor(len(tasks)) as threads:
        together = dict(zip(tasks, threads.map(starts, tasks, [seeds] * len(tasks)), strict=True))
    for task in tasks:
        np.testing.assert_array_equal(together[task], alone[task])
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002


def test_our_own_tasks_leave_the_global_generator_alone():
    """The array of the state changes only every 624 numbers; the position in it at once."""
    before = np.random.get_state()[2]  # noqa: NPY002
    starts("hammer_place/full", range(2))
    assert np.random.get_state()[2] == before  # noqa: NPY002


def test_loading_leaves_logging_as_it_was_however_many_threads_load():
    script = (
        "import logging\n"
        "from concurrent.futures import ThreadPoolExecutor\n"
        "from lerobot_buds.envs import EnvSettings, RobosuiteEnv\n"
        "seen = []\n"
        "def load(_):\n"
        "    RobosuiteEnv(EnvSettings('Lift', draws=False)).reset(seed=0)\n"
        "    seen.append(logging.root.manager.disable)\n"
        "with ThreadPoolExecutor(3) as threads:\n"
        "    list(threads.map(load, range(3)))\n"
        "print(seen)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("[0, 0, 0]\n", "")


def test_images_may_be_larger_than_the_window_that_robosuite_plans():
    env = RobosuiteEnv(EnvSettings("Lift", None, 650, "fastest"))
    assert env.reset(seed=0)[0]["pixels"]["agentview"].shape == (650, 650, 3)
    env.close()
