"""The demonstrator in the real simulation: it succeeds, varies, and what is recorded is what was done."""

import numpy as np
import pytest

from lerobot_buds.core import ConfigError
from lerobot_buds.demos.attempts import STEPS_AFTER_SUCCESS, attempt
from lerobot_buds.demos.stages import STAGES
from lerobot_buds.envs import EnvSettings, RobosuiteEnv
from lerobot_buds.envs.robosuite_env import SETTLE_STEPS

pytestmark = pytest.mark.slow

SETTINGS = EnvSettings("multitask_kitchen/task3_variant1", None, 16, "fastest")
SEEDS = range(40, 45)


@pytest.fixture(scope="module")
def env():
    env = RobosuiteEnv(SETTINGS)
    yield env
    env.close()


@pytest.fixture(scope="module")
def done(env):
    """Attempts from several seeds, each with the pot's place at its end."""
    return [(attempt(env, seed), env.state.position("pot_main")) for seed in SEEDS]


def test_the_demonstrator_succeeds_from_every_seed(done):
    assert [(a.seed, a.success, a.failure) for a, _ in done] == [(seed, True, "") for seed in SEEDS]


def test_demonstrations_vary(done):
    lengths = [len(a.arrays["action"]) for a, _ in done]
    assert len(set(lengths)) >= 3
    assert min(lengths) > 60 and max(lengths) < 400  # 3 to 20 seconds
    places = np.array([place for _, place in done])
    assert np.ptp(places[:, 0]) > 0.003


def test_rows_are_of_one_length_and_of_the_agreed_types(done):
    for a, _ in done:
        length = len(a.arrays["action"])
        kinds = {name: (rows.shape, rows.dtype) for name, rows in a.arrays.items()}
        assert kinds == {
            "agentview": ((length, 16, 16, 3), np.uint8),
            "eye_in_hand": ((length, 16, 16, 3), np.uint8),
            "agent_pos": ((length, 12), np.float32),
            "action": ((length, 4), np.float32),
            "true_stage": ((length, 1), np.int64),
        }


def test_stages_come_in_order_and_all_of_them(done):
    for a, _ in done:
        stages = a.arrays["true_stage"][:, 0]
        assert set(np.diff(stages)) == {0, 1}
        assert (stages[0], stages[-1]) == (0, 1)
        assert (stages == 1).sum() > STEPS_AFTER_SUCCESS


def test_actions_are_within_limits_at_human_speed(done):
    for a, _ in done:
        actions = a.arrays["action"]
        assert np.abs(actions).max() <= 1
        assert 0.2 < np.linalg.norm(actions[:, :3], axis=1).mean() < 0.75
        assert set(np.unique(actions[:, 3])) <= {-1.0, 1.0}


def test_replayed_actions_repeat_the_demonstration(env, done):
    for a, place in done[:2]:
        observation, _ = env.reset(seed=a.seed)
        for t, action in enumerate(a.arrays["action"]):
            # The row's observation is the one in which its action was taken.
            np.testing.assert_array_equal(observation["agent_pos"], a.arrays["agent_pos"][t])
            np.testing.assert_array_equal(observation["pixels"]["eye_in_hand"], a.arrays["eye_in_hand"][t])
            observation, _, success, _, _ = env.step(action)
        assert success
        assert np.linalg.norm(env.state.position("pot_main") - place) < 1e-3


def test_a_stage_that_nobody_can_do_is_refused_before_anything_is_done(env, monkeypatch):
    monkeypatch.delitem(STAGES, "push_pot")
    with pytest.raises(ConfigError, match=r"No demonstrator can do stage 'push_pot' of .*variant1\. .*'push_tray'"):
        attempt(env, 0)
    assert env.simulation.timestep == SETTLE_STEPS
