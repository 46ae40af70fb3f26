"""The original's literal goals and workspace, by one flag."""

import math

import numpy as np
import pytest

from lerobot_buds.envs import TASKS, EnvSettings, RobosuiteEnv
from lerobot_buds.envs.configuration_robosuite import RobosuiteEnvConfig

pytestmark = pytest.mark.slow

IN_POT = "cube_touches_pot"


@pytest.mark.parametrize(
    ("variant", "goal"),
    [
        ("task1_variant1", {"drawer_closed", IN_POT, "pot_on_stove"}),
        ("task1_variant2", {IN_POT, "pot_on_stove"}),
        ("task1_variant3", {"stove_on", IN_POT, "pot_on_stove"}),
        ("task2_variant1", {"stove_on", IN_POT, "pot_in_region"}),
        ("task2_variant2", {IN_POT, "pot_in_region"}),
        ("task2_variant3", {"drawer_closed", IN_POT, "pot_in_region"}),
        ("task3_variant1", {"drawer_closed", "stove_off", IN_POT, "pot_in_region"}),
        ("task3_variant2", {"drawer_closed", "stove_off", IN_POT, "pot_in_region"}),
        ("task3_variant3", {"drawer_closed", "stove_off", IN_POT, "pot_in_region"}),
    ],
)
def test_goals_are_the_task_zoos(variant, goal):
    assert set(TASKS[f"multitask_kitchen/{variant}"].as_released().goal) == goal


def test_a_cube_against_the_outside_of_the_pot_counts_for_the_release_alone():
    verdicts = {}
    for released in (False, True):
        env = RobosuiteEnv(EnvSettings("multitask_kitchen/task3_variant2", None, 16, draws=False, released=released))
        env.simulation.reset_with(np.random.default_rng(0))
        pot = np.array([0.15, -0.02, 0.9035])
        env.state.set_pose("pot", pot, 0.0)
        # Half of the cube is 15 mm, the outer face of the pot's wall is at 57.
        env.state.set_pose("cube", pot + np.array([-0.0715, 0.0, 0.017]), 0.0)
        env.simulation.sim.forward()
        assert env.state.touching("cube", "pot")
        verdicts[released] = env.simulation.succeeded()
        env.close()
    assert verdicts == {False: False, True: True}


def test_the_flag_frees_the_workspace_of_tool_use():
    env = RobosuiteEnv(EnvSettings("tool_use/full", None, 16, draws=False, released=True))
    assert math.isinf(env._task.workspace[0][1])
    env.reset(seed=0)
    assert env.executed(np.array([1, 0, 0, 0], dtype=np.float32))[0] == 1
    env.close()


def test_the_flag_reaches_environments_from_the_command_line():
    envs = RobosuiteEnvConfig(task="tool_use/full", released=True, image_size=16).create_envs(1)
    assert envs["tool_use"][0]._settings.released
    envs["tool_use"][0].close()
