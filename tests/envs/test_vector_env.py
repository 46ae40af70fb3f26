"""Several environments at once: equal to single ones, ended ones stand still, lost ones are reported."""

import logging
import os
import signal

import numpy as np
import pytest

from lerobot_buds.core import SimulatorError
from lerobot_buds.envs import TASKS, EpisodeVectorEnv

pytestmark = pytest.mark.slow

SEEDS = [21, 22]
LIMIT = 6


@pytest.fixture(scope="module")
def limited(settings):
    """The same task with a short time limit."""
    return type(settings)(settings.task, LIMIT, settings.image_size, settings.render_profile)


@pytest.fixture(scope="module")
def workers(limited):
    envs = EpisodeVectorEnv(limited, 2, in_workers=True)
    yield envs
    envs.close()


@pytest.fixture(scope="module")
def local(limited):
    envs = EpisodeVectorEnv(limited, 2, in_workers=False)
    yield envs
    envs.close()


@pytest.fixture(scope="module", params=["workers", "local"])
def envs(request):
    return request.getfixturevalue(request.param)


def batch(action, n=2):
    return np.tile(np.asarray(action, np.float32), (n, 1))


def member(observation, i):
    """Takes one environment's observation out of a batch."""
    return {k: member(v, i) for k, v in observation.items()} if isinstance(observation, dict) else observation[i]


def test_it_equals_single_environments_bit_for_bit_in_any_process(envs, trace, actions, digest):
    singles = [trace(seed, steps=LIMIT - 1) for seed in SEEDS]
    observation, info = envs.reset(seed=SEEDS)
    traces = [[digest(member(observation, i))] for i in range(2)]
    for action in actions[: LIMIT - 1]:
        observation, *_ = envs.step(batch(action))
        for i in range(2):
            traces[i].append(digest(member(observation, i)))
    assert traces == singles
    assert envs.observation_space.contains(observation)
    assert info["is_success"].tolist() == [False, False] and info["error"].tolist() == ["", ""]
    assert info["stages_done"].tolist() == [[False, False], [False, False]]


def test_one_seed_counts_up_and_a_range_is_taken_as_it_is(local, digest):
    by_list = digest(local.reset(seed=SEEDS)[0])
    assert digest(local.reset(seed=SEEDS[0])[0]) == by_list
    assert digest(local.reset(seed=range(21, 23))[0]) == by_list
    assert digest(local.reset(seed=[22, 21])[0]) != by_list


def test_an_ended_environment_stands_still_until_the_next_reset(envs, digest):
    envs.reset(seed=SEEDS)
    for step in range(LIMIT):
        last, rewards, terminated, truncated, _ = envs.step(batch([0.3, 0, 0, -1]))
        assert truncated.all() == (step == LIMIT - 1) and not terminated.any() and not rewards.any()
    frozen = digest(last)
    for _ in range(3):
        again, _, terminated, truncated, _ = envs.step(batch([-1, 1, 1, 1]))
        assert digest(again) == frozen and truncated.all() and not terminated.any()
    envs.reset(seed=SEEDS)
    assert digest(envs.step(batch([0.3, 0, 0, -1]))[0]) != frozen


def test_attributes_and_pictures_have_one_entry_an_environment(envs, settings):
    envs.reset(seed=SEEDS)
    assert envs.call("_max_episode_steps") == (LIMIT, LIMIT)
    assert envs.get_attr("task") == (settings.task,) * 2
    assert envs.call("task_description") == (TASKS[settings.task].description,) * 2
    for pictures in (envs.render(), envs.call("render"), envs.get_attr("render")):
        assert [(p.shape, p.dtype) for p in pictures] == [((32, 64, 3), np.uint8)] * 2
    assert envs.metadata["render_fps"] == 20
    with pytest.raises(AttributeError, match="flavour"):
        envs.call("flavour")


def test_a_killed_worker_loses_its_episode_and_nothing_else(workers, trace, digest, caplog):
    single = trace(SEEDS[1], steps=0)
    workers.reset(seed=SEEDS)
    workers.step(batch(np.zeros(4)))
    os.kill(workers._slots[0].process.pid, signal.SIGKILL)
    with caplog.at_level(logging.ERROR):
        for _ in range(LIMIT - 1):
            _, rewards, terminated, truncated, info = workers.step(batch(np.zeros(4)))
    assert truncated.tolist() == [True, True] and not terminated.any() and not rewards.any()
    assert "process died (exit status -9)" in info["error"][0] and info["error"][1] == ""
    (record,) = caplog.records
    assert "Environment 0 lost its episode (seed 21)" in record.message
    assert "the policy is not to blame" in record.message

    observation, info = workers.reset(seed=SEEDS)
    assert info["error"].tolist() == ["", ""]
    assert [digest(member(observation, 1))] == single
    _, _, _, truncated, _ = workers.step(batch(np.zeros(4)))
    assert not truncated.any()


def test_a_worker_killed_between_episodes_costs_only_its_next_one(workers, caplog):
    workers.reset(seed=SEEDS)
    process = workers._slots[1].process
    process.kill()
    process.wait()
    with caplog.at_level(logging.ERROR):
        _, info = workers.reset(seed=SEEDS)
    assert [bool(error) for error in info["error"]] == [False, True]
    _, _, _, truncated, _ = workers.step(batch(np.zeros(4)))
    assert truncated.tolist() == [False, True]
    _, info = workers.reset(seed=SEEDS)
    assert not any(info["error"])


def test_nan_in_the_simulation_is_a_lost_episode_not_a_failed_one(local, caplog):
    local.reset(seed=SEEDS)
    local._slots[1].env.simulation.sim.data.qpos[3] = np.nan
    with caplog.at_level(logging.ERROR):
        _, _, terminated, truncated, info = local.step(batch(np.zeros(4)))
    assert truncated.tolist() == [False, True] and not terminated.any()
    assert "the simulation diverged to NaN" in info["error"][1] and info["error"][0] == ""
    assert "Environment 1 lost its episode (seed 22)" in caplog.text
    _, info = local.reset(seed=SEEDS)
    assert not any(info["error"])


def test_an_action_that_is_not_finite_costs_one_episode(envs, caplog):
    envs.reset(seed=SEEDS)
    bad = batch(np.zeros(4))
    bad[0, 2] = np.nan
    with caplog.at_level(logging.ERROR):
        _, _, _, truncated, info = envs.step(bad)
    assert truncated.tolist() == [True, False]
    assert "action is not finite" in info["error"][0]


def test_environments_none_of_which_can_start_are_an_error(limited, monkeypatch):
    # A backend that MuJoCo does not know stands for one that is not installed: both fail when MuJoCo is imported.
    monkeypatch.setenv("MUJOCO_GL", "crayons")
    envs = EpisodeVectorEnv(limited, 1, in_workers=True)
    with pytest.raises(SimulatorError, match="To mend it, set MUJOCO_GL=egl") as error:
        envs.reset(seed=0)
    assert "\n" not in str(error.value) and "'crayons'" in str(error.value)
    envs.close()


def test_closing_ends_the_workers_and_may_be_repeated(workers):
    workers.reset(seed=SEEDS)
    processes = [slot.process for slot in workers._slots]
    workers.close()
    workers.close()
    assert [process.poll() for process in processes] == [0, 0]
