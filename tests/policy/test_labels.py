"""What the dataset says about its frames: skills, goals, what is beside them, and what came before."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets import LeRobotDataset

from lerobot_buds.core import (
    ACTION,
    EYE_IN_HAND_CAMERA,
    STATE,
    WORKSPACE_CAMERA,
    CheckpointError,
    DatasetError,
    SegmentationError,
)
from lerobot_buds.data import FrameTable, read_table
from lerobot_buds.policy.inputs import Observation
from lerobot_buds.policy.labels import UNDECIDED, Labels, LabelTable, history_rows
from lerobot_buds.policy.meta_controller import SkillMemory
from lerobot_buds.policy.rollout import Rollout

HISTORY = 5
GRIPPER = [2, 3]
PERIOD = 5
LONG = [0] * 12 + [1] * 9 + [0] * 7 + [2] * 11
"""Skills of one episode: its edges lie off the grid of decisions, no segment is shorter than a period."""


@pytest.fixture
def table(dataset_root, build):
    return LabelTable(dataset_root, build().config)


@pytest.fixture
def look_up(dataset_root, build):
    """Looks frames up, as a batch of the dataset that holds the very first frame."""
    first = LeRobotDataset("tests/segmented", root=dataset_root)[0]
    images = {camera: first[camera][None] for camera in (WORKSPACE_CAMERA, EYE_IN_HAND_CAMERA)}

    def look_up(table, *rows):
        if table.config.has_subgoals:
            table.goal_images.recognise(np.array([0]), images[WORKSPACE_CAMERA])
        return table.lookup(torch.tensor(rows), images)

    return look_up


@pytest.fixture
def labelled(build, monkeypatch):
    """Makes the table of a dataset that holds one episode of such skills, and nothing to see."""

    def labelled(skills, horizon=3, **overrides):
        config = build(subgoal_space="latent", **overrides).config
        config.n_skills = max(skills) + 1
        table = LabelTable.__new__(LabelTable)
        monkeypatch.setattr("lerobot_buds.policy.labels.load_labels", lambda _: (Record(horizon), *arrays))
        monkeypatch.setattr("lerobot_buds.policy.labels.read_table", lambda *_: table_of(len(skills)))
        labels = np.array(skills)
        arrays = labels, np.zeros_like(labels)  # goals are not asked for
        table.__init__("nowhere", config)
        table.latents = np.arange(len(skills), dtype=np.float32)[:, None]  # of a frame: its own number
        return table

    return labelled


class Record:
    def __init__(self, horizon):
        self.horizon = horizon


def table_of(frames):
    """What `read_table` finds of one episode."""
    columns = {STATE: np.zeros((frames, 5)), ACTION: np.zeros((frames, 4))}
    one = np.array([0])
    return FrameTable(Path("nowhere"), 20.0, one, one, np.array([frames]), columns, np.ones(frames, dtype=bool))


def test_goals_are_the_frames_at_min_of_horizon_boundary_and_end(table, look_up, dataset_root, labels, horizon):
    dataset = LeRobotDataset("tests/segmented", root=dataset_root)
    start = 0
    for episode in labels:
        last = len(episode) - 1
        for t, label in enumerate(episode):
            later = np.flatnonzero(episode[t:] != label)
            boundary = t + later[0] if len(later) else len(episode)
            goal = start + min(t + horizon, boundary, last)
            found = look_up(table, start + t)
            assert found.skill.tolist() == [label]
            image = found.goal[0].float() / 255
            torch.testing.assert_close(image, dataset[goal][WORKSPACE_CAMERA], rtol=0, atol=0)
        start += len(episode)


def test_frames_beside_an_edge_belong_to_the_other_skill_too(labelled):
    """Late: the skill before, at its goal. Early: the skill after, its goal within its own segment."""
    #                           0  1  2  3  4  5  6  7  8  9
    table = labelled([0, 0, 0, 0, 0, 0, 1, 1, 1, 0], boundary_overlap_s=0.1)  # two frames; half of three is one
    found = table.lookup(torch.arange(10), {})
    assert found.neighbour.tolist() == [0, 0, 0, 0, 1, 1, 0, 1, 0, 0]
    assert found.neighbour_goal[[4, 5, 6, 8], 0].tolist() == [7, 8, 6, 9]
    untouched = [0, 1, 2, 3, 7, 9]
    assert torch.equal(found.neighbour[untouched], found.skill[untouched])
    assert torch.equal(found.neighbour_goal[untouched], found.goal[untouched])


def test_an_early_frame_goes_no_further_than_the_next_skill(labelled):
    table = labelled([0] * 6 + [1] * 2 + [2] * 6, horizon=4, boundary_overlap_s=0.1)
    found = table.lookup(torch.arange(14), {})
    assert found.neighbour[4:10].tolist() == [1, 1, 0, 2, 1, 1]
    # Frames 4 and 5 pursue skill 1, which ends at 8; frame 7 pursues skill 2 as far as the horizon.
    assert found.neighbour_goal[4:10, 0].tolist() == [8, 8, 6, 11, 8, 9]


def test_half_of_a_segment_is_the_most_that_it_shares(labelled):
    found = labelled([0] * 5 + [1] * 5 + [0] * 4, boundary_overlap_s=10.0).lookup(torch.arange(14), {})
    assert found.neighbour.tolist() == [0, 0, 0, 1, 1, 0, 0, 1, 0, 0, 1, 1, 0, 0]


@pytest.mark.parametrize("settings", [{"boundary_overlap_s": 0.0}, {"skills": "single"}, {"skills": "flat"}])
def test_without_overlap_or_other_skills_nothing_is_beside(dataset_root, build, look_up, settings):
    found = look_up(LabelTable(dataset_root, build(**settings).config), *range(30))
    assert torch.equal(found.neighbour, found.skill) and torch.equal(found.neighbour_goal, found.goal)


def slow_memory(skills, period, n_skills):
    """What one remembers who decides at frame t, and at every period before it, as the labels say."""
    for t in range(len(skills)):
        decisions = list(range(t % period, t, period))
        held, held_for, done = UNDECIDED, 0, [0] * n_skills
        for d in decisions:
            if skills[d] != held:
                if held != UNDECIDED:
                    done[held] += 1
                held, held_for = skills[d], 0
            held_for += period
        yield held, held_for, done


@pytest.mark.parametrize("period", [1, 5])
def test_the_memory_is_that_of_somebody_who_decides_as_labelled(labelled, period):
    found = labelled(LONG, meta_period_s=period / 20).lookup(torch.arange(len(LONG)), {})
    held, held_for, done = zip(*slow_memory(LONG, period, 3), strict=True)
    assert found.held.tolist() == list(held)
    assert found.held_for.tolist() == list(held_for)
    assert found.finished.tolist() == list(done)


def test_a_rollout_that_does_what_the_labels_say_remembers_what_they_say(labelled, build):
    model, table = build().model.eval(), labelled(LONG)
    model.config.n_skills = 3
    shortest, longest = (torch.from_numpy(a).float() for a in (table.shortest, table.longest))
    assert table.shortest.tolist() == [7, 9, 11] and table.longest.tolist() == [12, 9, 11]
    model.memory = SkillMemory(model.config, shortest, longest)
    frame = Observation(torch.rand(1, 6, 32, 32), torch.zeros(1, 5), torch.zeros(1, dtype=torch.int64))
    rollout, seen = Rollout.start(model, frame), []
    model.decide = lambda situation, noise: (torch.zeros(1, dtype=torch.int64), torch.zeros(1, 4))
    model.act = lambda *_: torch.zeros(1, 1, 4)

    def as_labelled(t, wanted, rows, skill, subgoal):
        seen.append((t, rollout.skill.clone(), rollout.held_for.clone(), rollout.finished.clone()))
        return torch.tensor([wanted]), subgoal

    for t, wanted in enumerate(LONG):
        rollout.step(model, frame, override=partial(as_labelled, t, wanted))
    assert [t for t, *_ in seen] == list(range(0, 39, PERIOD))
    for t, *remembered in seen:
        found = table.lookup(torch.tensor([t]), {})
        assert [value.tolist() for value in remembered] == [
            found.held.tolist(),
            found.held_for.tolist(),
            found.finished.tolist(),
        ]


def test_a_flicker_does_not_count_as_done(build):
    memory = SkillMemory(build().config, torch.tensor([20.0, 11.0]), torch.tensor([40.0, 11.0]))
    held, held_for = torch.tensor([0, 0, 1, 1, UNDECIDED]), torch.tensor([9, 10, 5, 6, 100])
    assert memory.counts(held, held_for).tolist() == [False, True, False, True, False]


def test_the_memory_in_numbers(build):
    memory = SkillMemory(build().config, torch.tensor([1.0, 1.0]), torch.tensor([40.0, 10.0]))
    held, held_for = torch.tensor([0, 1, UNDECIDED]), torch.tensor([10, 30, 0])
    finished = torch.tensor([[0.0, 1.0], [2.0, 0.0], [0.0, 0.0]])
    assert memory(held, held_for, finished).tolist() == [
        [1.0, 0.0, 0.25, 0.0, 1.0],
        [0.0, 1.0, 1.0, 2.0, 0.0],  # longer than any demonstration: as long as the longest
        [0.0] * 5,
    ]
    memory = SkillMemory(build(skill_memory=False).config, memory.shortest, memory.longest)
    assert memory(held, held_for, finished).shape == (3, 0)


def test_offline_history_equals_the_fifo_of_a_rollout(table, look_up, dataset_root, build):
    model = build().model
    frames = read_table(dataset_root, [STATE])
    for start, end in zip(frames.starts, frames.ends, strict=True):
        states = torch.from_numpy(frames.columns[STATE][start:end].astype(np.float32))
        images, task = torch.rand(1, 6, 32, 32), torch.zeros(1, dtype=torch.int64)
        rollout = Rollout.start(model, Observation(images, states[:1], task))
        for index, state in zip(range(start, end), states, strict=True):
            torch.testing.assert_close(look_up(table, index).history, rollout.history)
            rollout.step(model, Observation(images, state[None], task))


def test_history_is_oldest_first_excludes_now_and_stops_at_the_episode_start():
    rows = history_rows(np.array([10, 12, 30]), np.array([10, 10, 10]), frames=3)
    assert rows.tolist() == [[10, 10, 10], [10, 10, 11], [27, 28, 29]]


def test_no_history(dataset_root, build, look_up):
    table = LabelTable(dataset_root, build(history_dims=[], current_dims=[0]).config)
    assert look_up(table, 3, 4).history.shape == (2, HISTORY, 0)


def test_images_of_another_shape_are_refused(dataset_root, build):
    config = build().config
    config.input_features = {**config.input_features, WORKSPACE_CAMERA: PolicyFeature(FeatureType.VISUAL, (3, 64, 64))}
    table = LabelTable(dataset_root, config)
    with pytest.raises(CheckpointError, match="no RGB camera of 64 x 64 pixels"):
        table.lookup(torch.tensor([0]), {WORKSPACE_CAMERA: torch.zeros(1, 3, 64, 64)})


def test_whole_demonstrations_are_one_skill_with_a_subgoal_ahead(dataset_root, build, look_up):
    table = LabelTable(dataset_root, build(skills="single", subgoal_horizon_s=0.15).config)
    found = look_up(table, *range(30))
    assert not found.skill.any() and found.weight.tolist() == [1.0] * 30
    expected = [min(t + 3, end - 1) for start, end in ((0, 12), (12, 20), (20, 30)) for t in range(start, end)]
    assert np.array_equal(found.goal, table.goal_images[np.array(expected)])


def test_flat_policies_have_no_goals(dataset_root, build, look_up):
    found = look_up(LabelTable(dataset_root, build(skills="flat").config), 3, 4)
    assert found.goal.shape == found.neighbour_goal.shape == (2, 0) and not found.skill.any()


def test_weights_make_skills_count_alike(dataset_root, build, look_up):
    found = look_up(LabelTable(dataset_root, build(balance_skills=True).config), *range(30))
    for skill in (0, 1):
        assert found.weight[found.skill == skill].sum() == pytest.approx(15.0)
    assert look_up(LabelTable(dataset_root, build().config), 3).weight.tolist() == [1.0]


def test_frames_without_label_or_outside_are_refused(table, look_up):
    with pytest.raises(DatasetError, match="frame 30"):
        look_up(table, 0, 30)
    table._skill = np.where(np.arange(30) == 4, -1, table._skill)
    with pytest.raises(SegmentationError, match="frame 4 "):
        look_up(table, 3, 4)
    table._present = table._present.copy()
    table._present[29] = False
    with pytest.raises(SegmentationError, match="frame 28 "):
        look_up(table, 28)


def test_labels_join_the_batches_of_the_dataset_and_no_others(build, batch_of):
    build()
    batch = batch_of(3, 12)
    labels = Labels.of(batch)
    assert labels.skill.tolist() == [0, 1] and labels.held.tolist() == [UNDECIDED] * 2
    policy = build()
    observation = {key: value for key, value in batch.items() if key.startswith(("observation", "action"))}
    with pytest.raises(DatasetError, match=r"labels\.skill.*preprocessor"):
        policy(observation)


def test_a_state_that_is_no_number_is_refused(build, meta, monkeypatch):
    """Where the policy reads it; with it every loss would be NaN."""
    config = build().config
    table = read_table(meta.root, [ACTION, STATE])
    table.columns[STATE][7, config.current_dims[0]] = np.nan
    monkeypatch.setattr("lerobot_buds.policy.labels.read_table", lambda *_: table)
    with pytest.raises(DatasetError, match=r"observation.state.*is nan in episode 0, frame 7"):
        LabelTable(Path(meta.root), config)
