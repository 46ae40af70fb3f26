"""Every demonstrator does its task. Nothing is drawn here: the demonstrators look at the true state."""

import numpy as np
import pytest

from lerobot_buds.demos.attempts import STEPS_AFTER_SUCCESS, attempt
from lerobot_buds.demos.stages import STAGES
from lerobot_buds.envs import TASKS, EnvSettings, RobosuiteEnv

pytestmark = pytest.mark.slow


def test_every_stage_of_every_task_is_known() -> None:
    assert {stage for task in TASKS.values() for stage in task.stages} <= set(STAGES)


@pytest.mark.parametrize(
    ("name", "seeds"),
    [("hammer_place/full", (0, 1, 2)), ("tool_use/full", (0, 1, 2)), ("tool_use/cube_fetched", (0,))],
)
def test_the_demonstrator_succeeds_within_its_limits(name: str, seeds: tuple[int, ...]) -> None:
    env, task = RobosuiteEnv(EnvSettings(name, draws=False)), TASKS[name]
    for seed in seeds:
        result = attempt(env, seed)
        assert result.success, result.failure
        actions, stages = result.arrays["action"], result.arrays["true_stage"][:, 0]
        assert len(actions) < task.max_steps / 2
        assert np.abs(actions).max() <= 1.0
        assert stages.tolist() == sorted(stages)
        assert set(stages) == set(range(len(task.stages)))
        hand_x = result.arrays["agent_pos"][:, 9]
        assert (hand_x + 0.05 * actions[:, 0] <= task.workspace[0][1] + 1e-6).all()
        # The hand keeps its last grip while it waits for the end.
        assert len(set(actions[-STEPS_AFTER_SUCCESS:, 3])) == 1
    env.close()


def test_executing_the_recorded_actions_again_ends_in_the_same_state() -> None:
    env = RobosuiteEnv(EnvSettings("tool_use/cube_fetched", draws=False))
    recorded = attempt(env, 7).arrays
    ended = env.state.position("cube_main")
    observation, _ = env.reset(seed=7)
    for expected, action in zip(recorded["agent_pos"], recorded["action"], strict=True):
        np.testing.assert_array_equal(observation["agent_pos"], expected)
        observation, _, success, _, _ = env.step(action)
    assert success
    np.testing.assert_array_equal(env.state.position("cube_main"), ended)
    env.close()
