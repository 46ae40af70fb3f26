"""LeRobot's environment type ``robosuite``, the names it takes, the versions it needs."""

import draccus
import pytest
from lerobot.configs import FeatureType
from lerobot.envs import EnvConfig

from lerobot_buds.core import EYE_IN_HAND_CAMERA, RENDER_PROFILES, STATE, WORKSPACE_CAMERA, ConfigError, SimulatorError
from lerobot_buds.envs import PROFILES, TASKS, EpisodeVectorEnv, profile_named, tasks_named
from lerobot_buds.envs.configuration_robosuite import RobosuiteEnvConfig
from lerobot_buds.envs.loading import check_versions, installed_version

TASK = "multitask_kitchen/task3_variant1"


def test_lerobot_knows_the_type():
    assert EnvConfig.get_choice_class("robosuite") is RobosuiteEnvConfig
    assert RobosuiteEnvConfig().type == "robosuite"


def test_features_name_what_policies_read():
    config = RobosuiteEnvConfig(image_size=64)
    assert config.features.keys() == config.features_map.keys()
    assert set(config.features_map.values()) == {"action", STATE, WORKSPACE_CAMERA, EYE_IN_HAND_CAMERA}
    images = {k: f.shape for k, f in config.features.items() if f.type is FeatureType.VISUAL}
    assert images == dict.fromkeys(("pixels/agentview", "pixels/eye_in_hand"), (64, 64, 3))
    assert config.features["agent_pos"].shape == (12,)


def test_environments_come_by_suite_and_number():
    config = RobosuiteEnvConfig(task=TASK, image_size=16, render_profile="fastest", episode_length=7)
    envs = config.create_envs(n_envs=3, use_async_envs=True)
    assert list(envs) == ["multitask_kitchen"] and list(envs["multitask_kitchen"]) == [0]
    vector = envs["multitask_kitchen"][0]
    assert isinstance(vector, EpisodeVectorEnv) and vector.num_envs == 3
    assert vector.call("_max_episode_steps") == (7, 7, 7)
    assert vector.single_observation_space["pixels"]["agentview"].shape == (16, 16, 3)
    vector.close()


def test_a_suite_gives_all_of_its_tasks():
    envs = RobosuiteEnvConfig(task="multitask_kitchen").create_envs(n_envs=1)
    members = [task for task in TASKS.values() if task.suite == "multitask_kitchen"]
    assert [e.get_attr("task")[0] for e in envs["multitask_kitchen"].values()] == [task.name for task in members]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"task": "multitask_kitchen/task3_varient1"}, "Did you mean 'multitask_kitchen/task3_variant1'"),
        ({"task": ""}, "There is no robosuite task ''"),
        ({"render_profile": "fastestest"}, "Did you mean 'fastest'"),
    ],
)
def test_unknown_names_are_refused_with_the_known_ones(wrong, said):
    with pytest.raises(ConfigError, match=said) as error:
        RobosuiteEnvConfig(**wrong)
    assert "\n" not in str(error.value)


def test_a_frame_rate_may_be_written_with_a_point():
    assert list(draccus.decode(RobosuiteEnvConfig, {"task": "Lift", "fps": "20.0"}).create_envs(1)) == ["Lift"]


def test_another_frame_rate_is_refused():
    with pytest.raises(ConfigError, match="20 control steps per second, not at 10"):
        RobosuiteEnvConfig(fps=10).create_envs(n_envs=1)


def test_tasks_are_named_singly_listed_or_by_suite():
    assert [t.name for t in tasks_named(TASK)] == [TASK]
    assert [t.name for t in tasks_named(f"{TASK} ,{TASK}")] == [TASK]
    assert tasks_named(f"{TASK}, multitask_kitchen")[0].name == TASK
    assert tasks_named("multitask_kitchen") == [t for t in TASKS.values() if t.suite == "multitask_kitchen"]
    with pytest.raises(ConfigError, match=r"no robosuite task 'multitask_kitchn'\. Did you mean 'multitask_kitchen'"):
        tasks_named(f"{TASK},multitask_kitchn")
    with pytest.raises(ConfigError) as error:
        tasks_named("laundry")
    assert all(repr(name) in str(error.value) for name in TASKS)


def test_every_task_is_whole():
    for name, task in TASKS.items():
        assert name == task.name and name.startswith(f"{task.suite}/")
        assert task.description and task.stages and task.goal and task.max_steps > 0


def test_profiles_by_name():
    assert [profile_named(name) for name in RENDER_PROFILES] == list(PROFILES.values())
    with pytest.raises(ConfigError, match=r"no render profile 'ful'\. Did you mean 'full'"):
        profile_named("ful")


@pytest.mark.parametrize(
    ("robosuite", "mujoco", "said"),
    [
        (None, "3.9.0", "robosuite is missing"),
        ("1.5.1", None, "mujoco is missing"),
        ("1.5.2", "3.9.0", "robosuite 1.5.2 is not supported, only 1.5.1"),
        ("1.4.1", "3.9.0", "robosuite 1.4.1"),
        ("1.5.1", "3.5.9", "mujoco 3.5.9 is not supported"),
        ("1.5.1", "3.10.0", "mujoco 3.10.0 is not supported: robosuite 1.5.1 needs >= 3.6 and < 3.10"),
        ("1.5.1", "4.0.0", "mujoco 4.0.0"),
        ("1.5.1", "2.3.7", "mujoco 2.3.7"),
    ],
)
def test_wrong_versions_are_refused_with_the_command_that_mends_them(robosuite, mujoco, said):
    with pytest.raises(SimulatorError, match="Run: pip install") as error:
        check_versions(robosuite, mujoco)
    assert said in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("mujoco", ["3.6.0", "3.7.1", "3.9.0", "3.9.1"])
def test_supported_versions_pass(mujoco):
    check_versions("1.5.1", mujoco)


def test_versions_are_read_from_the_installation():
    check_versions(installed_version("robosuite"), installed_version("mujoco"))
    assert installed_version("no-such-distribution") is None
