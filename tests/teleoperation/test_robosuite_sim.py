"""The robot itself, told what LeRobot would say."""

import logging

import numpy as np
import pytest
from lerobot.robots import make_robot_from_config
from lerobot.utils.errors import DeviceNotConnectedError
from lerobot.utils.keyboard_input import init_keyboard_listener

from lerobot_buds.core import OUR_FORMER_ACTION, ConfigError, SimulatorError
from lerobot_buds.data.writing import SMALLEST_VIDEO
from lerobot_buds.envs import ACTION_NAMES, CAMERAS, STATE_NAMES, EnvSettings, RobosuiteEnv
from lerobot_buds.teleoperation.config_robosuite_sim import SMALLEST_IMAGE, RobosuiteSimConfig

TASK = "tool_use/cube_fetched"
SETTINGS = {"task": TASK, "image_size": 32, "render_profile": "fastest"}
NAMES = (ACTION_NAMES, OUR_FORMER_ACTION)
RIGHT = dict(zip(ACTION_NAMES, [0.0, 0.5, 0.0, -1.0], strict=True))


@pytest.fixture
def robot(stdin, caplog):
    """Makes connected robots."""
    caplog.set_level(logging.INFO)
    made = []

    def robot(**settings):
        made.append(make_robot_from_config(RobosuiteSimConfig(**{**SETTINGS, **settings})))
        made[-1].connect()
        return made[-1]

    yield robot
    for each in made:
        if each.is_connected:
            each.disconnect()


def hand_of(shown):
    return np.array([shown[f"eef_{axis}.pos"] for axis in "xyz"])


def act(robot, steps=1, action=RIGHT):
    """Observes and acts, as LeRobot's loops do; returns what was observed last."""
    for _ in range(steps):
        shown = robot.get_observation()
        robot.send_action(action)
    return shown


def start_of(seed):
    env = RobosuiteEnv(EnvSettings(TASK, draws=False))
    state = env.reset(seed=seed)[0]["agent_pos"]
    env.close()
    return state


def state_of(shown):
    return np.array([shown[name] for name in STATE_NAMES], dtype=np.float32)


@pytest.mark.parametrize("task", [TASK, "real_kitchen/full"])
def test_it_shows_and_does_what_the_environment_does(robot, task):
    ours = robot(seed=5, task=task)
    assert set(ours.observation_features) == {*STATE_NAMES, *CAMERAS}
    assert list(ours.action_features) == ACTION_NAMES
    env = RobosuiteEnv(EnvSettings(task, image_size=32, render_profile="fastest"))
    observation, _ = env.reset(seed=5)
    for _ in range(4):
        shown = ours.get_observation()
        assert set(shown) == set(ours.observation_features)
        np.testing.assert_array_equal(state_of(shown), observation["agent_pos"])
        for camera in CAMERAS:
            np.testing.assert_array_equal(shown[camera], observation["pixels"][camera])
        executed = ours.send_action({name: 2 * value for name, value in RIGHT.items()})
        assert list(executed) == ACTION_NAMES and executed["gripper.pos"] == -1
        observation, *_ = env.step(2 * np.array(list(RIGHT.values()), dtype=np.float32))
    env.close()


def test_one_action_is_done_for_one_observation(robot):
    ours = robot()
    before = hand_of(act(ours))
    for _ in range(20):  # LeRobot slides an arm so, where a person takes over
        assert set(ours.send_action(RIGHT).values()) == {0.0}
    moved = np.linalg.norm(hand_of(ours.get_observation()) - before)
    assert 0 < moved < 0.02 and ours.facts()["steps"] == 1


def test_joint_positions_are_not_followed_and_half_an_action_is_refused(robot):
    ours = robot()
    shown = ours.get_observation()
    ours.send_action({name: shown[name] for name in STATE_NAMES})
    assert ours.facts()["steps"] == 0
    with pytest.raises(SimulatorError, match=r"lacks \['gripper.pos'\]"):
        ours.send_action(dict.fromkeys(ACTION_NAMES[:3], 0.0))
    with pytest.raises(SimulatorError, match=r"lacks \['delta_x.pos', "):
        ours.send_action({"shoulder_pan.pos": 0.0})  # somebody else's recording, replayed


def test_recordings_with_the_former_names_of_actions_are_replayed(robot):
    moved = [state_of(act(robot(), 4, dict(zip(names, RIGHT.values(), strict=True)))) for names in NAMES]
    np.testing.assert_array_equal(*moved)
    assert np.linalg.norm(moved[0] - start_of(0)) > 0.01


def test_the_least_image_is_the_least_video():
    assert SMALLEST_IMAGE == SMALLEST_VIDEO


def test_who_reads_keys_late_is_asked_again(robot):
    ours = robot(episode_length=2)
    logging.info("Recording episode 0")
    act(ours, 3)  # nobody listens yet
    listener, events = init_keyboard_listener()
    try:
        act(ours, 2)
        assert [events["exit_early"], ours.facts()["steps"]] == [True, 2]
        events["exit_early"] = False
        act(ours, 2)
        assert not events["exit_early"]  # once is enough
    finally:
        listener.stop()


def test_every_recorded_episode_begins_with_the_next_seed(robot):
    ours = robot(seed=2)
    logging.info("Recording episode 0")
    np.testing.assert_array_equal(state_of(act(ours)), start_of(2))
    act(ours, 3)
    logging.info("Reset the environment")
    shown = act(ours, 3)
    np.testing.assert_array_equal(state_of(shown), start_of(3))  # it stands still
    logging.info("Re-record episode")
    logging.info("Recording episode 0")
    np.testing.assert_array_equal(state_of(act(ours)), start_of(3))
    assert ours.facts() | {"stages": None} == {
        "task": TASK,
        "seed": 3,
        "phase": "episode",
        "steps": 1,
        "succeeded": False,
        "stages": None,
        "episodes": 0,
    }
    logging.info("Recording episode 1")  # without a phase in between
    np.testing.assert_array_equal(state_of(act(ours)), start_of(4))


def test_an_episode_ends_by_itself_and_stands_still(robot, caplog):
    ours = robot(episode_length=3)
    logging.info("Recording episode 0")
    last = act(ours, 6)
    assert ours.facts()["steps"] == 3 and "Seed 0: no success after 3 steps (0.1 s)." in caplog.messages
    np.testing.assert_array_equal(state_of(last), state_of(ours.get_observation()))


def test_where_nothing_is_announced_scenes_follow_by_themselves(robot):
    ours = robot(episode_length=3, seed=7)
    act(ours, 3)
    np.testing.assert_array_equal(state_of(ours.get_observation()), start_of(8))


def test_a_paused_policy_leaves_the_hand_where_it_is_until_a_person_acts(robot):
    ours = robot(episode_length=5)
    act(ours, 2)
    lerobot = logging.getLogger("lerobot.rollout.strategies.dagger")
    lerobot.info("Pausing engine - robot holds position")
    act(ours, 4)
    assert ours.facts()["steps"] == 2
    lerobot.info("Entering correction mode - human teleop control")
    act(ours, 6)
    assert ours.facts()["steps"] == 8  # no new scene amid a correction
    logging.info("Correction 1 saved")
    act(ours, 2)
    assert ours.facts()["steps"] == 8
    lerobot.info("Resuming autonomous mode - resetting engine and interpolator")
    act(ours)
    assert (ours.facts()["seed"], ours.facts()["steps"]) == (1, 1)


def test_a_person_does_not_demonstrate_from_seeds_for_evaluation_and_a_policy_may_act_there(robot):
    ours = robot(seed=100_000)
    act(ours)
    logging.info("Recording episode 0")
    with pytest.raises(ConfigError, match=r"Seed 100001 is for evaluation.*below 100000"):
        act(ours)
    ours.disconnect()
    policys = robot(seed=100_000)
    logging.getLogger("lerobot.rollout.strategies.core").info("Inference engine started")
    logging.info("Recording episode 0")
    act(policys)
    logging.getLogger("lerobot.rollout.strategies.dagger").info("DAgger strategy ready (input=keyboard)")
    with pytest.raises(ConfigError, match="is for evaluation"):
        act(policys)


def test_how_far_an_episode_came_is_said_at_the_end(robot, caplog):
    ours = robot(seed=9)
    act(ours, 2)
    ours.disconnect()
    assert "Seed 9: no success after 2 steps (0.1 s)." in caplog.messages


def test_it_must_be_connected(robot):
    ours = robot()
    ours.disconnect()
    assert not ours.is_connected
    for use in (ours.get_observation, lambda: ours.send_action(RIGHT), ours.disconnect, ours.facts):
        with pytest.raises(DeviceNotConnectedError):
            use()


def test_a_log_that_is_off_is_said(stdin, caplog):
    caplog.set_level(logging.WARNING)
    ours = make_robot_from_config(RobosuiteSimConfig(**SETTINGS))
    ours.connect()
    ours.disconnect()
    assert any("cannot tell when episodes begin" in message for message in caplog.messages)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"task": "tool_use/cube_fetchd"}, "Did you mean 'tool_use/cube_fetched'"),
        ({"task": "multitask_kitchen"}, "names 9 tasks; one robot runs exactly one"),
        ({"render_profile": "fine"}, "'fine'"),
        ({"seed": -1}, "robot.seed=-1 cannot work; it must be at least 0"),
        ({"image_size": 31}, "robot.image_size=31 cannot work; it must be at least 32"),
        ({"episode_length": 0}, "robot.episode_length=0"),
        ({"end_after_success_s": -1.0}, "robot.end_after_success_s=-1.0"),
        ({"new_scene_s": float("nan")}, "robot.new_scene_s=nan"),
    ],
)
def test_settings_that_cannot_work_are_refused(settings, message):
    with pytest.raises(ConfigError, match=message):
        RobosuiteSimConfig(**{**SETTINGS, **settings})
