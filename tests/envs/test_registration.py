"""The tasks in Gymnasium's registry: every one passes its checker, and is the environment that it is elsewhere."""

import re
import subprocess
import sys
import warnings
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from lerobot_buds.core import ConfigError, SimulatorError
from lerobot_buds.envs import STOCK_TASKS, TASKS, RobosuiteEnv, env_id, register_tasks

pytestmark = pytest.mark.slow

PAGE = Path(__file__).parents[2] / "docs/environments.md"
SMALL = {"image_size": 16, "render_profile": "fastest"}
TASK = "multitask_kitchen/task3_variant1"  # that of the folder's environment
IDS = {env_id(name): task for name, task in (TASKS | STOCK_TASKS).items()}
DRAWN = {env_id(next(tasks).name) for _, tasks in groupby(TASKS.values(), lambda task: task.suite)} | {env_id("Lift")}
"""One of every table; the others differ in start, goal and objects alone. A renderer takes most of a check's time."""
LAZY = """
import sys, gymnasium
before = set(gymnasium.registry)
env = gymnasium.make("lerobot_buds.envs:lerobot_buds/ToolUse-v0")
print(len(set(gymnasium.registry) - before), env.unwrapped.task, *sys.modules)
"""


def test_names_are_gymnasiums_and_no_two_are_the_same():
    assert len(IDS) == len(TASKS) + len(STOCK_TASKS) == 25
    assert set(IDS) == {name for name in gym.registry if name.startswith("lerobot_buds/")}
    named = {
        "tool_use/full": "ToolUse",
        "tool_use/cube_fetched": "ToolUse-CubeFetched",
        "multitask_kitchen/task1_variant1": "MultitaskKitchen-Task1-Variant1",
        "NutAssemblySquare": "NutAssemblySquare",
    }
    assert {task: env_id(task) for task in named} == {k: f"lerobot_buds/{v}-v0" for k, v in named.items()}


def test_what_the_page_shows_runs(capsys):
    (code,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), flags=re.M | re.S)
    exec(code, {})
    assert capsys.readouterr().out.startswith("(64, 64, 3) (12,) 0.0 [False False")


def test_a_name_brings_its_module_and_nothing_heavy():
    done = subprocess.run([sys.executable, "-c", LAZY], capture_output=True, text=True, check=True)
    number, task, *modules = done.stdout.split()
    assert (int(number), task) == (len(IDS), "tool_use/full")
    assert {"lerobot", "mujoco", "robosuite", "torch"}.isdisjoint(modules)


@pytest.mark.usefixtures("tasks_of_its_own")
def test_registering_again_changes_nothing_but_brings_what_is_new():
    before = dict(gym.registry)
    with warnings.catch_warnings(action="error"):
        register_tasks()
    assert dict(gym.registry) == before
    TASKS["tool_use/again"] = replace(TASKS["tool_use/full"], name="tool_use/again")
    register_tasks()
    assert gym.registry.keys() - before == {"lerobot_buds/ToolUse-Again-v0"}


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_accepts_every_task(name, monkeypatch):
    if name not in DRAWN:
        monkeypatch.setattr(RobosuiteEnv, "_draw", lambda *_: np.zeros((16, 16, 3), np.uint8))
    env = gym.make(name, **SMALL)
    assert env.spec.max_episode_steps == IDS[name].max_steps
    assert env.get_wrapper_attr("task_description") == IDS[name].description
    with warnings.catch_warnings(action="error"):  # its complaints are warnings
        check_env(env.unwrapped, skip_render_check=name not in DRAWN)
    env.close()


def test_an_episode_is_that_of_our_own_environment(trace, actions, digest):
    env = gym.make(env_id(TASK), **SMALL)
    with warnings.catch_warnings(action="error"):
        observation, info = env.reset(seed=11)
        seen = [digest(observation)]
        for action in actions[:10]:
            observation, reward, terminated, truncated, info = env.step(action)
            seen.append(digest(observation))
    assert seen == trace(11)
    assert (reward, terminated, truncated, info["is_success"]) == (0.0, False, False, False)
    assert info["stages_done"].tolist() == [False, False]
    np.testing.assert_array_equal(env.render(), observation["pixels"]["agentview"])
    env.close()


@pytest.mark.parametrize(
    ("mode", "options"), [("sync", {}), ("async", {"context": "forkserver"})], ids=["sync", "async"]
)
def test_several_at_once_equal_single_ones(mode, options, trace, actions, digest):
    envs = gym.make_vec(env_id(TASK), 2, vectorization_mode=mode, vector_kwargs=options, **SMALL)
    steps = [envs.reset(seed=[21, 22])[0]] + [envs.step(np.stack([action] * 2))[0] for action in actions[:4]]
    assert envs.call("task") == (TASK,) * 2
    envs.close()
    for i, seed in enumerate((21, 22)):
        assert [digest(member(step, i)) for step in steps] == trace(seed, steps=4)


def member(observation, i):
    return {k: member(v, i) for k, v in observation.items()} if isinstance(observation, dict) else observation[i]


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning", "ignore:.*ERROR:UserWarning")
def test_a_worker_that_was_forked_too_late_says_so_instead_of_waiting_for_ever(env):
    env.reset(seed=0)  # has drawn
    envs = gym.make_vec(env_id(TASK), 1, vectorization_mode="async", vector_kwargs={"context": "fork"}, **SMALL)
    envs.reset_async(seed=0)
    with pytest.raises(SimulatorError, match=r"forked from one that had already drawn.*'forkserver'"):
        envs.reset_wait(timeout=100)
    envs.close()


def test_the_time_limit_is_gymnasiums():
    env = gym.make(env_id(TASK), max_episode_steps=2, **SMALL)
    env.reset(seed=0)
    assert [env.step(np.zeros(4, np.float32))[3] for _ in range(2)] == [False, True]
    env.close()
    longer = gym.make(env_id(TASK), max_episode_steps=10**6)
    assert longer.unwrapped._max_episode_steps > 10**6  # the task's own does not come first


def test_settings_are_keyword_arguments():
    env = gym.make(env_id("kitchen/full"), image_size=24, render_profile="full", released=True, render_mode=None)
    settings = env.unwrapped.settings
    assert (settings.image_size, settings.render_profile, settings.released) == (24, "full", True)
    assert env.observation_space["pixels"]["eye_in_hand"].shape == (24, 24, 3)
    assert env.unwrapped.render() is None and env.unwrapped.render_mode is None


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (
            {"image_sise": 64},
            "multitask_kitchen/task3_variant1 has no setting 'image_sise'. Did you mean 'image_size'?",
        ),
        ({"render_profile": "fats"}, "Did you mean 'fast'"),
        ({"image_size": 0}, "image_size=0 cannot work"),
    ],
)
def test_what_is_wrong_is_refused_before_anything_is_built(wrong, said):
    with pytest.raises(ConfigError, match=said):
        gym.make(env_id(TASK), **wrong)


@pytest.mark.filterwarnings("ignore:.*that is not in the possible render_modes:UserWarning")
def test_an_unknown_render_mode_is_refused():
    with pytest.raises(ConfigError, match=r"no render_mode 'rgb_aray'. Did you mean 'rgb_array'"):
        gym.make(env_id(TASK), render_mode="rgb_aray")
