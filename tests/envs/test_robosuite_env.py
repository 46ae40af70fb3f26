"""One environment: Gymnasium's contract, determinism, the hand, the images, what is refused."""

import numpy as np
import pytest

from lerobot_buds.core import ConfigError, SimulatorError
from lerobot_buds.envs import ACTION_NAMES, CAMERAS, FPS, PROFILES, STATE_NAMES, EnvSettings, RobosuiteEnv

pytestmark = pytest.mark.slow

NOTHING = np.zeros(4, np.float32)


def test_observations_are_those_of_the_spaces(env):
    observation, info = env.reset(seed=3)
    assert env.observation_space.contains(observation)
    assert env.action_space.shape == (len(ACTION_NAMES),)
    assert observation["agent_pos"].shape == (len(STATE_NAMES),) == (12,)
    assert set(observation["pixels"]) == set(CAMERAS)
    assert observation["render_profile"] == list(PROFILES).index("fastest") and observation["control_rate"] == FPS
    np.testing.assert_allclose(observation["agent_pos"][9:], env.state.hand, atol=1e-6)
    assert info["is_success"] is False and info["stages_done"].tolist() == [False, False]
    assert env.render().shape == (16, 16, 3)


def test_a_seed_decides_everything_whatever_ran_before(env, trace):
    first = trace(11)
    trace(12, steps=25)
    np.random.seed(1)  # noqa: NPY002 (robosuite draws from this generator; episodes must not)
    assert trace(11) == first
    np.random.seed(2)  # noqa: NPY002
    assert trace(11) == first
    assert not set(trace(12)) & set(first)


def test_unseeded_episodes_differ(env, digest):
    env.reset(seed=5)
    assert digest(env.reset()[0]) != digest(env.reset()[0])


def test_the_hand_stays_upright(env, actions):
    env.reset(seed=4)
    site = env.simulation.sim.model.site_name2id("gripper0_right_grip_site")
    tilts = []
    for action in actions:
        env.step(action)
        down = -env.simulation.sim.data.site_xmat[site].reshape(3, 3)[2, 2]
        tilts.append(np.degrees(np.arccos(np.clip(down, -1, 1))))
    # The arm starts tilted by some degrees and needs a quarter of a second to come upright.
    assert max(tilts[5:]) < 1.0


def test_the_arm_stays_within_the_bounds_of_its_space(env):
    env.reset(seed=4)
    model, space = env.simulation.sim.model, env.observation_space["agent_pos"]
    limits = np.array([model.jnt_range[model.joint_name2id(f"robot0_joint{i}")] for i in range(1, 8)])
    assert (space.low[:7] < limits[:, 0] - 0.2).all() and (space.high[:7] > limits[:, 1] + 0.2).all()
    for corner in ((1, 1, 1), (-1, -1, -1), (-1, 1, 1), (1, -1, -1)):
        for _ in range(30):
            observation, *_ = env.step(np.array([*corner, -corner[0]], np.float32))
            assert space.contains(observation["agent_pos"])
    assert np.isfinite(space.low).all() and np.isfinite(space.high).all()


def test_an_episode_starts_settled_with_the_gripper_opening(env):
    env.reset(seed=6)
    assert env.simulation.timestep == 5
    left, right = env.state.fingers
    assert left > 0.021 and right < -0.021  # half open at 0.0208 before the settle steps
    before = env.state.position("pot_main")
    env.step(np.array([0, 0, 0, -1], np.float32))
    assert np.abs(env.state.position("pot_main") - before).max() < 1e-3


def test_actions_are_clipped(env, digest):
    env.reset(seed=6)
    clipped, *_ = env.step(np.ones(4, np.float32))
    env.reset(seed=6)
    assert digest(env.step(np.full(4, 5.0, np.float32))[0]) == digest(clipped)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_an_action_that_is_not_finite_is_refused(env, bad):
    env.reset(seed=6)
    with pytest.raises(SimulatorError, match=r"Step 0 of multitask_kitchen/task3_variant1: the action is not finite"):
        env.step(np.array([0, bad, 0, 0], np.float32))
    with pytest.raises(SimulatorError, match=r"takes actions of \(4,\), not \(3,\)"):
        env.step(np.zeros(3, np.float32))


def test_a_diverged_simulation_is_an_error_and_the_next_episode_is_sound(env, trace):
    sound = trace(8)
    env.simulation.sim.data.qpos[0] = np.nan
    with pytest.raises(SimulatorError, match="diverged to NaN"):
        env.step(NOTHING)
    assert trace(8) == sound


def test_success_ends_the_episode(env):
    env.reset(seed=9)
    env.state.set_joint("cabinet_slide", 0.0)
    at = env.state.position("pot_main")
    shift = np.array([0.15 - at[0], 0.0, 0.0])
    env.state.set_pose("cube", env.state.position("cube_main") + shift, 0.0)
    env.state.set_pose("pot", at + shift, 0.0)
    _, reward, terminated, truncated, info = env.step(NOTHING)
    assert (reward, terminated, truncated, info["is_success"]) == (1.0, True, False, True)
    assert info["stages_done"].tolist() == [True, True]


def test_the_time_limit_truncates():
    env = RobosuiteEnv(EnvSettings("multitask_kitchen/task3_variant1", 2, 16, "fastest"))
    env.reset(seed=0)
    ends = [env.step(NOTHING)[2:4] for _ in range(2)]
    env.reset(seed=0)
    ends.append(env.step(NOTHING)[2:4])
    assert ends == [(False, False), (False, True), (False, False)]
    env.close()
    env.close()


def test_profiles_draw_differently_and_both_cameras_see():
    images = {}
    for profile in ("fast", "full"):
        env = RobosuiteEnv(EnvSettings("multitask_kitchen/task3_variant1", None, 64, profile))
        images[profile] = env.reset(seed=0)[0]["pixels"]
        env.close()
    for drawn in images.values():
        assert list(drawn) == ["agentview", "eye_in_hand"]
        for image in drawn.values():
            assert (image.shape, image.dtype) == ((64, 64, 3), np.uint8)
            assert image.std() > 15
        # Top row first: the bright table is at the bottom of what the workspace camera sees, the wall at the top.
        assert drawn["agentview"][-8:].mean() > drawn["agentview"][:8].mean() + 30
        assert not np.array_equal(drawn["agentview"], drawn["eye_in_hand"])
    # The robot is not in view of the eye in the hand, which therefore sees the same.
    assert not np.array_equal(images["fast"]["agentview"], images["full"]["agentview"])


def test_two_environments_do_not_draw_into_each_other(env, settings, digest):
    alone = digest(env.reset(seed=2)[0])
    other = RobosuiteEnv(settings)
    other.reset(seed=3)
    assert digest(env.reset(seed=2)[0]) == alone
    other.close()
    assert digest(env.reset(seed=2)[0]) == alone


@pytest.mark.parametrize("wrong", [{"task": "multitask_kitchen/task9"}, {"render_profile": "fats"}])
def test_unknown_names_are_refused_before_anything_is_built(wrong):
    known = {"task": "multitask_kitchen/task3_variant1", "render_profile": "fast"}
    with pytest.raises(ConfigError, match="Did you mean"):
        RobosuiteEnv(EnvSettings(**(known | wrong)))
