"""Runs LeRobot's own ``lerobot-rollout``, unmodified, on a simulated robot."""

import importlib
import json
import signal
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.policies import make_policy, make_pre_post_processors
from lerobot.scripts import lerobot_rollout

from lerobot_buds.core import ACTION, IMAGE_PREFIX, STATE, CheckpointError, ConfigError
from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.modeling_buds import BudsPolicy

pytestmark = pytest.mark.slow

PLUGIN = "lerobot_robot_simulated"
STEPS = 17


@pytest.fixture
def save(meta, small, tmp_path):
    """Saves a policy for a dataset, as training does; it keeps the weights it begins with."""

    def save(dataset=meta, **overrides):
        policy = make_policy(BudsConfig(**{**small, **overrides}), ds_meta=dataset)
        folder = tmp_path / "policy"
        for part in (policy, *make_pre_post_processors(policy.config, dataset_stats=dataset.stats)):
            part.save_pretrained(folder)
        return folder

    return save


@pytest.fixture
def robots(monkeypatch):
    """The robots that were made, first to last."""
    monkeypatch.syspath_prepend(Path(__file__).parent / "robots")
    made = importlib.import_module(PLUGIN).SimulatedArm.made
    made.clear()
    return made


@pytest.fixture
def rollout(meta, task, robots, run_script):
    """Runs ``lerobot-rollout`` on a robot like that of the dataset, until its user presses Ctrl-C."""

    def rollout(policy, **options):
        image = next(iter(meta.camera_keys))
        settings = {
            "policy.path": policy,
            "robot.discover_packages_path": PLUGIN,
            "robot.type": "simulated_arm",
            "robot.joints": meta.features[STATE]["names"],
            "robot.actuators": meta.features[ACTION]["names"],
            "robot.views": [key.removeprefix(IMAGE_PREFIX) for key in meta.camera_keys],
            "robot.pixels": meta.features[image]["shape"][0],
            "robot.steps": STEPS,
            "fps": meta.fps,
            "task": task,
            "duration": 60,  # seconds, should Ctrl-C never come
            "return_to_initial_position": "false",  # the way back would be 150 actions of LeRobot's
        }
        arguments = [f"--{key}={value}" for key, value in {**settings, **options}.items()]
        handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        handlers |= {number: signal.getsignal(number) for number in (signal.SIGHUP, signal.SIGQUIT)}
        try:
            run_script(lerobot_rollout.main, *arguments)
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
        return robots[-1]

    return rollout


def actions_of(robot):
    """What the robot was told, ``(T, A)``, in the order of its actuators."""
    return np.array([[action[name] for name in robot.config.actuators] for action in robot.told])


def observation_of(robot, shown):
    """What the robot showed, as a policy wants it."""
    state = torch.tensor([[shown[name] for name in robot.config.joints]])
    images = {IMAGE_PREFIX + view: torch.from_numpy(shown[view]).permute(2, 0, 1)[None] for view in robot.config.views}
    return {STATE: state, **{key: image.float() / 255 for key, image in images.items()}}


def test_a_robot_is_told_what_the_policy_says(save, rollout):
    folder = save()
    robot = rollout(folder)
    assert not robot.is_connected
    assert [set(action) for action in robot.told] == [set(robot.config.actuators)] * STEPS
    actions = actions_of(robot)
    assert np.isfinite(actions).all() and np.abs(actions).max() <= 1
    # LeRobot looks once before it begins, to know where the robot is.
    shown = robot.shown[1:]
    assert len(shown) == STEPS
    policy = BudsPolicy.from_pretrained(folder)
    expected = torch.cat([policy.select_action(observation_of(robot, each)) for each in shown])
    np.testing.assert_allclose(actions, expected, rtol=0, atol=1e-6)
    assert np.abs(np.diff(actions, axis=0)).max(axis=1).min() > 1e-4  # it does see that every observation is another


def test_an_arm_of_lerobots_own_is_told_degrees(so101, so101_policy, rollout):
    robot = rollout(
        so101_policy,
        **{
            "robot.joints": so101.features[STATE]["names"],
            "robot.actuators": so101.features[ACTION]["names"],
            "robot.views": ["front", "wrist"],
            "robot.pixels": 16,
            "robot.spread": 50.0,
            "fps": so101.fps,
            "task": "Pick",
        },
    )
    actions = actions_of(robot)
    assert actions.shape == (STEPS, 6)
    policy = BudsPolicy.from_pretrained(so101_policy)
    expected = torch.cat([policy.select_action(observation_of(robot, each)) for each in robot.shown[1:]])
    np.testing.assert_allclose(actions, expected, rtol=0, atol=1e-3)
    low, high = (so101.stats[ACTION][bound] for bound in ("min", "max"))
    reach = 0.06 * (high - low)
    assert (actions > low - reach).all() and (actions < high + reach).all() and np.abs(actions).max(axis=0).min() > 1
    assert set(actions[:, 5]) <= {0.0, 100.0}


def test_cameras_may_have_other_names(save, rollout):
    names = {f"{IMAGE_PREFIX}top": f"{IMAGE_PREFIX}agentview", f"{IMAGE_PREFIX}wrist": f"{IMAGE_PREFIX}eye_in_hand"}
    robot = rollout(save(), **{"robot.views": ["wrist", "top"], "rename_map": json.dumps(names)})
    assert len(robot.told) == STEPS


@pytest.mark.parametrize("fps", [20, 12])
def test_the_meta_controller_decides_four_times_a_second(save, record, rollout, tmp_path, fps):
    """Before a scene that stands still nothing but a decision, with its newly drawn subgoal, changes the action."""
    dataset = record(tmp_path / "data", fps=fps)
    robot = rollout(save(dataset, drawn_subgoals=True), **{"robot.still": "true", "fps": fps})
    held = [len(list(group)) for _, group in groupby(map(tuple, actions_of(robot)))]
    period = round(0.25 * fps)
    assert held == [period] * (STEPS // period) + [STEPS % period]


def test_a_task_may_be_left_out_where_there_is_one_but_not_be_wrong(save, rollout, robots):
    folder = save()
    assert len(rollout(folder, task="").told) == STEPS
    with pytest.raises(ConfigError, match=r"'Close the drawr'.*Did you mean 'Close the drawer'"):
        rollout(folder, task="Close the drawr")
    assert robots[-1].told == [] and not robots[-1].is_connected


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        ({"robot.views": ["agentview"]}, r"needs \['observation.images.eye_in_hand'\].*It has.*agentview"),
        ({"robot.joints": ["joint_1.pos", "joint_2.pos"]}, r"observation.state: .*\(5,\).*\(2,\)"),
        ({"robot.pixels": 48}, r"\(3, 32, 32\).*\(3, 48, 48\)"),
    ],
)
def test_robots_that_do_not_fit_are_refused(save, rollout, robots, robot, message):
    with pytest.raises(CheckpointError, match=message):
        rollout(save(), **robot)
    assert robots[-1].told == [] and not robots[-1].is_connected
