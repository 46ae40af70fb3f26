"""LeRobot's own ``lerobot-rollout`` with a policy of ours on the simulated robot: alone, by episodes, and corrected."""

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_buds.cli.segment import SegmentConfig, segment
from lerobot_buds.core import ACTION, SKILL_ID, STATE
from lerobot_buds.data import read_collection, read_table
from lerobot_buds.envs import EnvSettings, RobosuiteEnv, tasks_named
from lerobot_buds.teleoperation.keys import press

from .conftest import briefly

pytestmark = pytest.mark.slow

TASK = "multitask_kitchen/task3_variant1"
TEXT = tasks_named(TASK)[0].description


@pytest.fixture
def rollout(run, scripted, checkpoint, tmp_path, monkeypatch):
    """Lets the policy act; `keys` are pressed at certain steps of the loop, as a user would."""

    def rollout(strategy, keys=None, **options):
        steps = iter(range(10**9))

        def wait(seconds):
            step = next(steps)
            if step in (keys or {}):
                press(keys[step])
            briefly(seconds)

        for module in ("base", "core", "dagger", "episodic"):
            monkeypatch.setattr(f"lerobot.rollout.strategies.{module}.precise_sleep", wait)
        settings = {
            "strategy.type": strategy,
            "policy.path": checkpoint,
            "robot.type": "robosuite_sim",
            "robot.task": TASK,
            "robot.image_size": 32,
            "robot.render_profile": "fastest",
            "robot.new_scene_s": 0,
            "fps": 20,
            "play_sounds": "false",
        }
        if strategy != "base":
            root = tmp_path / strategy
            settings |= {"dataset.repo_id": "tests/rollout_x", "dataset.root": root, "robot.dataset_root": root}
            settings |= {"dataset.single_task": TEXT, "dataset.fps": 20, "dataset.push_to_hub": "false"}
            settings |= {"dataset.video": "false", "dataset.episode_time_s": 300, "dataset.reset_time_s": 300}
        else:
            settings |= {"task": TEXT}
        run("lerobot_rollout", **{**settings, **options})
        return tmp_path / strategy

    return rollout


def test_a_policy_acts_in_scene_after_scene(rollout, said):
    rollout("base", **{"robot.seed": 100_000, "robot.episode_length": 6, "duration": 5})
    ends = [line for line in said if line.startswith("Seed")]
    assert ends[:2] == [f"Seed {seed}: no success after 6 steps (0.3 s)." for seed in (100_000, 100_001)]


def test_episodes_of_a_policy_are_recorded_from_seeds_for_evaluation(rollout):
    root = rollout("episodic", **{"robot.seed": 100_000, "robot.episode_length": 6, "dataset.num_episodes": 2})
    dataset = LeRobotDataset("tests/rollout_x", root=root)
    rows = dataset.hf_dataset.with_format("numpy")
    assert np.bincount(rows["episode_index"]).tolist() == [6, 6]
    env = RobosuiteEnv(EnvSettings(TASK, draws=False))
    for first, seed in ((0, 100_000), (6, 100_001)):
        np.testing.assert_array_equal(rows[first][STATE], env.reset(seed=seed)[0]["agent_pos"])
    env.close()
    record = read_collection(root)
    assert (record["demonstrator"], record["tasks"][0]["episode_seeds"]) == ("policy", [100_000, 100_001])


def test_a_person_takes_over_and_the_correction_is_labelled_by_the_library(rollout, segmented, tmp_path):
    keys = {5: "pause", 9: "correct", 60: "correct"}
    teleoperator = {"teleop.type": "scripted", "teleop.task": TASK, "teleop.seeds": [0]}
    root = rollout("dagger", keys, **{"strategy.num_episodes": 1, **teleoperator})
    dataset = LeRobotDataset("tests/rollout_x", root=root)
    assert dataset.num_episodes == 1 and len(dataset) > 40  # keys are read some frames late
    rows = dataset.hf_dataset.with_format("numpy")[:]
    assert rows["intervention"].all() and np.abs(rows[ACTION]).max() > 0.3
    hand = rows[STATE][:, 9:12]
    assert np.linalg.norm(hand[-1] - hand[0]) > 0.05  # the person moved it
    (task,) = read_collection(root)["tasks"]
    assert (task["episode_seeds"], task["demonstrators"]) == ([0], ["correction"])
    skills = tmp_path / "labelled"
    segment(
        SegmentConfig(
            "tests/rollout_x",
            root,
            output_root=skills,
            work_dir=tmp_path / "work",
            library=str(segmented),
        )
    )
    labels = read_table(skills, [SKILL_ID]).columns[SKILL_ID]
    assert len(labels) == len(dataset) and labels.min() >= 0


def test_a_correction_does_not_start_from_a_seed_for_evaluation(rollout):
    teleoperator = {"teleop.type": "scripted", "teleop.task": TASK, "teleop.seeds": [0]}
    with pytest.raises(ValueError, match="Seed 100000 is for evaluation"):
        rollout("dagger", **{"strategy.num_episodes": 1, "robot.seed": 100_000, **teleoperator})
