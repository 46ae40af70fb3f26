"""The whole chain, small but real: demonstrations, segmentation, LeRobot's own training and evaluation."""

import logging
import sys
from pathlib import Path

import pytest
from lerobot.scripts import lerobot_eval, lerobot_train

from lerobot_buds.cli import segment
from lerobot_buds.core import (
    COLLECTION_FILE,
    EYE_IN_HAND_CAMERA,
    SEGMENTATION_FILE,
    SKILL_ID,
    STATE,
    SUBGOAL_INDEX,
    TRUE_STAGE,
    WORKSPACE_CAMERA,
    read_json,
    sha256_of_file,
)
from lerobot_buds.data import LocalDataset
from lerobot_buds.envs import TASKS
from lerobot_buds.policy.modeling_buds import BudsPolicy

pytestmark = pytest.mark.slow

SMALL_POLICY = [
    "--policy.type=buds",
    "--policy.device=cpu",
    "--policy.encoder=conv",
    "--policy.norm=group",
    "--policy.conv_channels=[8, 8]",
    "--policy.keypoints=8",
    "--policy.head_widths=[32]",
]


def run(main, command: str, *arguments: object) -> None:
    """Runs a console script's function with its arguments, in this process."""
    level = logging.getLogger().level
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [command, *map(str, arguments)])
        main()
    logging.getLogger().setLevel(level)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("chain")


@pytest.fixture(scope="module")
def skills(demonstrations, folder) -> Path:
    """The segmented dataset."""
    run(
        segment.main,
        "lerobot-buds-segment",
        "--repo_id=tests/demos",
        f"--root={demonstrations}",
        f"--output_root={folder / 'skills'}",
        f"--work_dir={folder / 'segment'}",
        *("--representation.image_size=32", "--representation.steps=10", "--representation.batch_size=32"),
        *("--representation.device=cpu", "--discovery.max_skills=3"),
    )
    return folder / "skills"


@pytest.fixture(scope="module")
def training(skills, folder):
    """The run's folder, and the keys of every batch that the policy was given."""
    keys = []
    forward = BudsPolicy.forward

    def noted(policy, batch):
        keys.append(set(batch))
        return forward(policy, batch)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BudsPolicy, "forward", noted)
        run(
            lerobot_train.main,
            "lerobot-train",
            *SMALL_POLICY,
            "--dataset.repo_id=tests/demos_skills",
            f"--dataset.root={skills}",
            f"--output_dir={folder / 'train'}",
            *("--batch_size=16", "--num_workers=0", "--steps=8", "--save_freq=8", "--log_freq=4", "--seed=1"),
        )
    return folder / "train", keys


def evaluate(run_folder: Path, output: Path, envs: int, in_workers: bool, steps: int) -> Path:
    """Runs LeRobot's evaluation of as many episodes as environments; returns its folder."""
    run(
        lerobot_eval.main,
        "lerobot-eval",
        f"--policy.path={run_folder / 'checkpoints/last/pretrained_model'}",
        "--policy.device=cpu",
        *("--env.type=robosuite", "--env.image_size=32", "--env.render_profile=fastest"),
        *(f"--env.episode_length={steps}", f"--eval.n_episodes={envs}", f"--eval.batch_size={envs}"),
        *(f"--eval.use_async_envs={in_workers}", "--seed=50000", f"--output_dir={output}"),
    )
    return output


@pytest.fixture(scope="module")
def evaluation(training, folder) -> Path:
    """The evaluation's folder: two environments in two workers, 25 control steps."""
    run_folder, _ = training
    return evaluate(run_folder, folder / "eval", envs=2, in_workers=True, steps=25)


def test_skills_are_written_beside_the_demonstrations(demonstrations, skills, folder):
    before, after = LocalDataset(demonstrations).features, LocalDataset(skills).features
    assert set(after) - set(before) == {SKILL_ID, SUBGOAL_INDEX}
    record = read_json(skills / SEGMENTATION_FILE)
    assert len(record["episodes"]) == 4
    assert (skills / COLLECTION_FILE).read_bytes() == (demonstrations / COLLECTION_FILE).read_bytes()
    videos = [sorted(sha256_of_file(p) for p in root.rglob("*.mp4")) for root in (demonstrations, skills)]
    assert videos[0] == videos[1] and videos[0]
    assert {p.name for p in (folder / "segment").iterdir()} >= {"timeline.png", "reconstructions.png"}


def test_training_never_sees_the_true_stages(training):
    run_folder, batches = training
    assert len(batches) == 8 and all("index" in keys and TRUE_STAGE not in keys for keys in batches)
    checkpoint = run_folder / "checkpoints/000008/pretrained_model"
    assert (checkpoint / "model.safetensors").exists()
    config = BudsPolicy.from_pretrained(checkpoint).config
    assert set(config.input_features) == {WORKSPACE_CAMERA, EYE_IN_HAND_CAMERA, STATE}
    assert TRUE_STAGE not in (checkpoint / "config.json").read_text()
    assert config.tasks == [TASKS["multitask_kitchen/task3_variant1"].description]
    assert config.fps == 20 and 1 <= config.n_skills <= 3


def test_evaluation_runs_the_checkpoint_in_several_environments(evaluation):
    info = read_json(evaluation / "eval_info.json")
    (task,) = info["per_task"]
    assert task["task_group"] == "multitask_kitchen"
    assert len(task["metrics"]["successes"]) == info["overall"]["n_episodes"] == 2
    assert info["overall"]["pc_success"] in (0.0, 50.0, 100.0)
    assert list(evaluation.rglob("*.mp4"))


@pytest.mark.parametrize(("envs", "in_workers"), [(1, False), (1, True), (2, False), (4, False), (4, True)])
def test_any_number_of_environments_can_be_evaluated_at_once(training, tmp_path, envs, in_workers):
    run_folder, _ = training
    info = read_json(evaluate(run_folder, tmp_path / "eval", envs, in_workers, steps=3) / "eval_info.json")
    assert info["overall"]["n_episodes"] == envs
    assert info["per_task"][0]["metrics"]["successes"] == [False] * envs  # three steps suffice for nothing
