"""LeRobot's ``lerobot-record`` and ``lerobot-replay`` on the simulated robot: recordings are as our own."""

import importlib

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_buds.cli.segment import SegmentConfig, segment
from lerobot_buds.core import ACTION, DISTRIBUTION
from lerobot_buds.data import read_collection
from lerobot_buds.envs import ACTION_NAMES, CAMERAS, STATE_NAMES, EnvSettings, RobosuiteEnv, tasks_named
from lerobot_buds.representation import RepresentationConfig
from lerobot_buds.segmentation import DiscoveryConfig

pytestmark = pytest.mark.slow

SEEDS = [3, 4]


def actions_of(task, seed):
    return importlib.import_module("lerobot_teleoperator_scripted").actions_of(task, seed)


@pytest.mark.parametrize("task", ["tool_use/cube_fetched", "multitask_kitchen/task3_variant1"])
def test_demonstrations_are_recorded_replayed_segmented_and_trained_on(task, record, run, tmp_path, said):
    text = tasks_named(task)[0].description
    root = record(task, SEEDS, text)
    dataset = LeRobotDataset("tests/recorded", root=root)
    check_recording(dataset, task, text)

    said.clear()
    run(
        "lerobot_replay",
        **{
            "robot.type": "robosuite_sim",
            "robot.task": task,
            "robot.seed": SEEDS[1],
            "robot.image_size": 32,
            "robot.render_profile": "fastest",
            "dataset.repo_id": "tests/recorded",
            "dataset.root": root,
            "dataset.episode": 1,
            "play_sounds": "false",
        },
    )
    steps = len(actions_of(task, SEEDS[1]))
    assert f"Seed {SEEDS[1]}: success after {steps} steps ({steps / 20:.1f} s)." in said

    segment(
        SegmentConfig(
            "tests/recorded",
            str(root),
            output_root=str(tmp_path / "skills"),
            work_dir=str(tmp_path / "work"),
            representation=RepresentationConfig(image_size=32, steps=2, batch_size=8, device="cpu"),
            discovery=DiscoveryConfig(max_skills=2),
        )
    )
    train(run, tmp_path)


def check_recording(dataset, task, text):
    """The frames, actions and record of two demonstrations by the script."""
    assert dataset.fps == 20 and dataset.meta.robot_type == "robosuite_sim" and list(dataset.meta.tasks.index) == [text]
    features = dataset.features
    assert features[ACTION]["names"] == ACTION_NAMES and features["observation.state"]["names"] == STATE_NAMES
    assert {f"observation.images.{camera}" for camera in CAMERAS} == set(dataset.meta.camera_keys)
    rows = dataset.hf_dataset.with_format("numpy")
    for number, seed in enumerate(SEEDS):
        episode = rows.filter(lambda row, number=number: row["episode_index"] == number)
        told = actions_of(task, seed)
        # LeRobot looks whether the episode is over before a frame, not after it.
        assert len(told) <= len(episode) <= len(told) + 1
        np.testing.assert_array_equal(np.stack(episode[ACTION])[: len(told)], told)
        check_first_frame(episode[0], task, seed)
    collection = read_collection(dataset.root)
    versions = collection.pop("versions")
    assert set(versions) == {DISTRIBUTION, "lerobot", "robosuite", "mujoco"}
    assert collection == {
        "version": 2,
        "demonstrator": "teleoperated",
        "tasks": [
            {
                "name": task,
                "description": text,
                "episode_seeds": SEEDS,
                "succeeded": [True, True],
                "demonstrators": ["teleoperated"] * 2,
            }
        ],
        "render_profile": "fastest",
        "image_size": 32,
    }


def check_first_frame(row, task, seed):
    """It shows the scene of the seed, as the environment does."""
    env = RobosuiteEnv(EnvSettings(task, image_size=32, render_profile="fastest"))
    observation, _ = env.reset(seed=seed)
    env.close()
    np.testing.assert_array_equal(row["observation.state"], observation["agent_pos"])
    for camera in CAMERAS:
        np.testing.assert_array_equal(np.asarray(row[f"observation.images.{camera}"]), observation["pixels"][camera])


def train(run, folder):
    run(
        "lerobot_train",
        **{
            "policy.type": "buds",
            "policy.encoder": "conv",
            "policy.norm": "group",
            "policy.conv_channels": [8, 8],
            "policy.keypoints": 4,
            "policy.head_widths": [16],
            "policy.device": "cpu",
            "dataset.repo_id": "tests/skills",
            "dataset.root": folder / "skills",
            "output_dir": folder / "policy",
            "steps": 2,
            "batch_size": 4,
            "num_workers": 0,
        },
    )
    assert (folder / "policy/checkpoints/last/pretrained_model/model.safetensors").exists()


def test_scenes_follow_one_another_under_teleoperate(run, scripted, said):
    task = "tool_use/cube_fetched"
    run(
        "lerobot_teleoperate",
        **{
            "robot.type": "robosuite_sim",
            "robot.task": task,
            "robot.image_size": 32,
            "robot.render_profile": "fastest",
            "robot.episode_length": 5,
            "teleop.type": "scripted",
            "teleop.task": task,
            "teleop.seeds": "[]",
            "fps": 20,
            "teleop_time_s": 2,
        },
    )
    assert said[:2] == [f"Seed {seed}: no success after 5 steps (0.2 s)." for seed in (0, 1)]
