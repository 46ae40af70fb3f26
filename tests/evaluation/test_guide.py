"""Real demonstrations as a guide: an observation is found where it was recorded, and its subgoal is done."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy

from lerobot_buds.core import IMAGE_PREFIX, STATE, TRUE_STAGE, CheckpointError, DatasetError, read_json, write_json
from lerobot_buds.data import cached_frames, read_table, scale_images
from lerobot_buds.envs import TASKS
from lerobot_buds.envs.configuration_robosuite import RobosuiteEnvConfig
from lerobot_buds.evaluation import guide as guide_module
from lerobot_buds.evaluation.checkpoint import Checkpoint, load_checkpoint
from lerobot_buds.evaluation.episodes import Decider, EpisodeRecorder
from lerobot_buds.evaluation.guide import Advice, Guide
from lerobot_buds.policy import BudsConfig
from lerobot_buds.segmentation import load_labels

TASK = TASKS["multitask_kitchen/task3_variant1"]
ENV = RobosuiteEnvConfig(image_size=32, render_profile="fastest")


@pytest.fixture(scope="module")
def policy(checkpoint: Path) -> Checkpoint:
    return load_checkpoint(str(checkpoint), ENV, TASK)


@pytest.fixture(scope="module")
def guide(segmented: Path, policy: Checkpoint) -> Guide:
    return Guide.open(segmented, TASK, policy.policy.config, neighbors=3)


@pytest.fixture(scope="module")
def observe(segmented: Path):
    """What the environment would show at some frames of the dataset."""
    cameras = {name: cached_frames(segmented, IMAGE_PREFIX + name) for name in ("agentview", "eye_in_hand")}
    state = read_table(segmented, [STATE]).columns[STATE]

    def observe(*indices: int):
        rows = list(indices)
        pixels = {name: np.array(frames[rows]).transpose(0, 2, 3, 1) for name, frames in cameras.items()}
        return {"pixels": pixels, "agent_pos": state[rows]}

    return observe


def test_an_observation_is_found_at_its_own_frame(guide: Guide, observe) -> None:
    indices = [0, 57, len(guide.frames.skills) - 1]
    latents = guide.latents(observe(*indices, 3), np.array([0, 1, 2]))
    for index, latent in zip(indices, latents, strict=True):
        distances = guide.frames.distances(latent)
        assert guide.frames.nearest(distances, 1).tolist() == [index]
        assert distances[index] < 1e-4 < np.partition(distances, 1)[1]


def test_the_stages_are_numbered_as_in_the_task(guide: Guide) -> None:
    for start, end in zip(guide.frames.starts, guide.frames.ends, strict=True):
        stages = guide.stages[start:end]
        assert stages[0] == 0 and stages[-1] == 1 and set(np.diff(stages)) == {0, 1}


def decide(policy: Checkpoint, guide: Guide, observation, proposed: int, **sources: str):
    """Lets both environments of a batch decide, the second of which has ended."""
    recorders = [EpisodeRecorder(TASK, seed, False) for seed in (1, 2)]
    recorders[1].ended = True
    imagined = torch.full((2, policy.policy.config.subgoal_dim), 7.0)
    decider = Decider(policy.policy, guide, **sources)
    policy.policy.eval()
    with torch.inference_mode():
        skills, subgoals = decider.decide(
            observation, recorders, torch.tensor([0, 1]), torch.tensor([proposed, proposed]), imagined
        )
    assert not recorders[1].decisions
    return recorders[0].decisions[0], skills, subgoals


def test_the_meta_controller_is_only_watched_unless_others_are_asked(policy, guide, observe) -> None:
    index = 20
    native = int(guide.frames.skills[index])
    nearest = guide.frames.nearest(guide.frames.distances(guide.frames.latents[index]), 3)
    foreign = next(skill for skill in range(3) if guide.frames.is_foreign(skill, nearest))
    for proposed in (native, foreign):
        decision, skills, subgoals = decide(policy, guide, observe(index, 0), proposed)
        assert (decision.proposed, decision.skill) == (proposed, proposed) and skills.tolist() == [proposed] * 2
        assert decision.foreign is (proposed == foreign)
        assert (subgoals == 7.0).all()
    decision, *_ = decide(policy, None, observe(index, 0), native)
    assert decision.foreign is None


@pytest.mark.parametrize("source", ["demonstrations", "stages"])
def test_the_demonstrations_subgoal_is_encoded_in_the_space_of_their_skill(
    policy, guide, observe, segmented, source
) -> None:
    index = 20
    alone = replace(guide, neighbors=1)
    _, labels, subgoal_index = load_labels(segmented)
    decision, skills, subgoals = decide(
        policy, alone, observe(index, index), 0, skills_from=source, subgoals_from="demonstrations"
    )
    assert decision.skill == skills[0] == labels[index] and decision.foreign is False
    goal = torch.from_numpy(np.array(cached_frames(segmented, f"{IMAGE_PREFIX}agentview")[subgoal_index[[index]]]))
    goal = scale_images(goal.float() / 255, policy.policy.config.image_shape)
    with torch.no_grad():
        expected = policy.policy.model.skills.encode_goals(skills[:1], goal)
    torch.testing.assert_close(subgoals[:1], expected)


def test_latent_subgoals_of_demonstrations_are_standardised(segmented, small, guide, observe) -> None:
    index = 20
    meta = LeRobotDatasetMetadata("tests/x", root=segmented)
    latent = make_policy(BudsConfig(**small, subgoal_space="latent"), ds_meta=meta)
    checkpoint = Checkpoint(latent, dict, lambda action: action, "")
    alone = Guide.open(segmented, TASK, latent.config, neighbors=1)
    assert alone.goals.shape == guide.frames.latents.shape
    _, labels, subgoal_index = load_labels(segmented)
    _, skills, subgoals = decide(
        checkpoint, alone, observe(index, index), 0, skills_from="demonstrations", subgoals_from="demonstrations"
    )
    assert skills[0] == labels[index]
    goal = torch.from_numpy(guide.frames.latents[subgoal_index[[index]]].astype(np.float32))
    torch.testing.assert_close(subgoals[:1], (goal - latent.model.goals.mean) / latent.model.goals.std)


def test_other_labels_and_other_tasks_are_refused(segmented: Path, policy: Checkpoint) -> None:
    config = policy.policy.config
    for change, message in (
        ({"segmentation": "0" * 64}, "other labels"),
        ({"n_skills": 9, "segmentation": None}, "skills=9"),
        ({"skills": "flat", "n_skills": 1, "segmentation": None}, "leave dataset_root out"),
        ({"fps": 30}, "fps=30"),
    ):
        with pytest.raises(CheckpointError, match=message):
            Guide.open(segmented, TASK, replace(config, **change))
    with pytest.raises(DatasetError, match="no demonstration of"):
        Guide.open(segmented, TASKS["tool_use/full"], config)


def test_a_dataset_with_the_stages_of_others_tells_none(segmented: Path, policy: Checkpoint, tmp_path: Path) -> None:
    copy = shutil.copytree(segmented, tmp_path / "copy")
    write_json(copy / "meta/buds/collection.json", {"version": 2, "stages": ["grasp_tool", "close_drawer"]})
    assert len(Guide.open(copy, TASK, policy.policy.config).stages) == 0
    write_json(copy / "meta/buds/collection.json", {"version": 2, "stages": list(TASK.stages)[:1]})
    assert len(Guide.open(copy, TASK, policy.policy.config).stages) == 0


def test_stages_of_any_number_type_are_read_and_damaged_ones_named(
    segmented: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stages = guide_module._stages(segmented, TASK)
    table = read_table(segmented, [TRUE_STAGE])
    for dtype in (np.float32, np.uint8):
        typed = replace(table, columns={TRUE_STAGE: table.columns[TRUE_STAGE].astype(dtype)})
        monkeypatch.setattr("lerobot_buds.data.read_table", lambda *_, typed=typed: typed)
        np.testing.assert_array_equal(guide_module._stages(segmented, TASK), stages)
    wrong = replace(table, columns={TRUE_STAGE: table.columns[TRUE_STAGE] + 50})
    monkeypatch.setattr("lerobot_buds.data.read_table", lambda *_: wrong)
    with pytest.raises(DatasetError, match=r"'true_stage' goes from 50 to \d+, but .* names \d+ stages"):
        guide_module._stages(segmented, TASK)


def test_a_policy_that_was_trained_with_renamed_cameras_is_guided(
    segmented: Path, checkpoint: Path, policy: Checkpoint, guide: Guide, tmp_path: Path
) -> None:
    """LeRobot's rename_map is kept in the checkpoint's processor; goals are those of the same camera."""
    names = {
        IMAGE_PREFIX + "agentview": IMAGE_PREFIX + "camera1",
        IMAGE_PREFIX + "eye_in_hand": IMAGE_PREFIX + "camera2",
    }
    copy = shutil.copytree(checkpoint, tmp_path / "renamed")
    for path in copy.glob("*.json"):
        text = path.read_text()
        for old, new in names.items():
            text = text.replace(old, new)
        path.write_text(text)
    processor = read_json(copy / "policy_preprocessor.json")
    (step,) = [step for step in processor["steps"] if step.get("registry_name") == "rename_observations_processor"]
    step["config"]["rename_map"] = names
    write_json(copy / "policy_preprocessor.json", processor)
    renamed = load_checkpoint(str(copy), ENV, TASK)
    assert renamed.renamed == names and policy.renamed == {}
    assert renamed.policy.config.stacked_cameras == list(names.values())
    guided = Guide.open(segmented, TASK, renamed.policy.config, 3, renamed.renamed)
    np.testing.assert_array_equal(guided.goals, guide.goals)


def info(done: tuple[bool, bool], success: bool = False, error: str = "") -> dict[str, object]:
    return {"stages_done": np.array(done), "is_success": np.bool_(success), "error": error}


def test_a_recorder_keeps_one_episode_and_nothing_behind_its_end() -> None:
    recorder = EpisodeRecorder(TASK, 1, keeps_pictures=True)
    images = [np.zeros((4, 6, 3), dtype=np.uint8), np.ones((4, 6, 3), dtype=np.uint8)]
    recorder.see(images, info((False, False)), ended=False)
    for step, skill in enumerate((0, 0, 1)):
        recorder.act(skill)
        recorder.see(images, info((step >= 1, False)), ended=step == 2)
    recorder.act(2)
    recorder.decide(2, Advice(2))
    recorder.see(images, info((True, True), success=True), ended=True)
    episode = recorder.episode()
    assert episode.labels.tolist() == [0, 0, 1] and episode.switches == 1 and episode.length == 3
    assert (episode.stage_steps, episode.success, episode.decisions) == ((2, None), False, ())
    assert len(recorder.pictures) == 4 and recorder.pictures[0].shape == (4, 12, 3)


def test_an_episode_that_the_simulator_loses_says_so() -> None:
    recorder = EpisodeRecorder(TASK, 1, keeps_pictures=False)
    recorder.see([], info((False, False), error="diverged"), ended=True)
    episode = recorder.episode()
    assert (episode.error, episode.length, episode.success) == ("diverged", 0, False)


def test_noise_depends_on_the_seed_alone() -> None:
    first, again, other = (EpisodeRecorder(TASK, seed, False) for seed in (5, 5, 6))
    draws = [[recorder.draw_noise(64) for _ in range(3)] for recorder in (first, again, other)]
    np.testing.assert_array_equal(draws[0], draws[1])
    assert np.abs(np.array(draws[0]) - draws[2]).max() > 1 and draws[0][0].dtype == np.float32
    assert not np.array_equal(draws[0][0], draws[0][1])
