"""The nearest demonstration frames, and what is read from them, against hand-made demonstrations."""

from dataclasses import replace

import numpy as np
import pytest

from lerobot_buds.evaluation.guide import Advice, Guide
from lerobot_buds.evaluation.neighbors import DemonstrationFrames

# Three demonstrations of five frames on a line; the middle one is of another task and must never be asked.
PLACES = [[0.0, 1.0, 2.0, 3.0, 4.0], [0.5] * 5, [0.1, 1.1, 2.1, 3.1, 4.1], [10.0, 11.0, 12.0, 13.0, 14.0]]
SKILLS = [[0, 0, 1, 1, 1], [3] * 5, [0, 0, 0, 2, 2], [1, 1, 1, 1, 1]]
STAGES = [[0, 0, 0, 1, 1], [0] * 5, [0, 0, 0, 1, 1], [0, 1, 1, 1, 1]]


def frames_with(reach: int = 1) -> DemonstrationFrames:
    starts = np.array([0, 10, 15])
    return DemonstrationFrames(
        latents=np.concatenate(PLACES)[:, None],
        starts=starts,
        ends=starts + 5,
        skills=np.concatenate(SKILLS),
        subgoals=np.minimum(np.arange(20) + 2, 5 * (np.arange(20) // 5) + 4),
        n_skills=4,
        reach=reach,
    )


@pytest.fixture
def guide() -> Guide:
    goals = np.zeros((20, 3, 2, 2), dtype=np.uint8)
    return Guide(frames_with(), goals, np.concatenate(STAGES), representation=None, labels="", neighbors=3)


def test_the_nearest_frames_are_of_distinct_demonstrations_nearest_first() -> None:
    frames = frames_with()
    distances = frames.distances(np.array([2.0]))
    assert frames.nearest(distances, 5).tolist() == [2, 12, 15]
    assert frames.nearest(distances, 2).tolist() == [2, 12]
    assert frames.nearest(distances, 5, frames.skills == 2).tolist() == [13]
    assert frames.nearest(distances, 5, frames.skills == 3).tolist() == []


def test_the_nearest_frames_are_those_of_a_plain_search() -> None:
    rng = np.random.default_rng(0)
    latents, starts = rng.normal(size=(60, 7)), np.array([0, 11, 23, 40])
    frames = DemonstrationFrames(
        latents, starts, np.array([11, 23, 40, 60]), np.zeros(60, dtype=int), np.arange(60), 1, 2
    )
    for _ in range(20):
        latent, allowed = rng.normal(size=7), rng.random(60) < 0.5
        found = frames.nearest(frames.distances(latent), 3, allowed)
        best: dict[int, int] = {}
        for index in sorted(np.flatnonzero(allowed), key=lambda i: float(np.sum((latents[i] - latent) ** 2))):
            best.setdefault(int(np.searchsorted(starts, index, side="right")), int(index))
        assert found.tolist() == list(best.values())[:3]


@pytest.mark.parametrize(
    ("reach", "frame", "native"),
    [(0, 1, {0}), (1, 1, {0, 1}), (1, 0, {0}), (2, 0, {0, 1}), (1, 4, {1}), (9, 14, {0, 2}), (1, 10, {0})],
)
def test_labels_count_within_reach_and_within_their_demonstration(reach: int, frame: int, native: set[int]) -> None:
    frames = frames_with(reach)
    found = {skill for skill in range(4) if not frames.is_foreign(skill, np.array([frame]))}
    assert found == native


def test_one_frame_that_uses_a_skill_is_enough() -> None:
    frames = frames_with(0)
    assert not frames.is_foreign(2, np.array([0, 13]))
    assert frames.is_foreign(2, np.array([0, 12]))
    assert frames.is_foreign(2, np.array([], dtype=int))


def test_the_majority_wins_and_the_nearest_breaks_ties() -> None:
    frames = frames_with()
    assert frames.majority_skill(np.array([13, 2, 3])) == 1
    assert frames.majority_skill(np.array([13, 2])) == 2
    assert frames.majority_skill(np.array([2, 13])) == 1


def test_a_subgoal_is_that_of_the_nearest_frame_of_the_skill() -> None:
    frames = frames_with()
    distances = frames.distances(np.array([1.9]))
    assert frames.subgoal_frame(1, distances) == 4  # frame 2 aims at frame 4
    assert frames.subgoal_frame(0, distances) == 14  # frame 12
    assert frames.subgoal_frame(0, distances, np.arange(20) < 5) == 3  # frame 1
    assert frames.subgoal_frame(3, distances) is None


def test_the_meta_controller_is_judged_and_kept(guide: Guide) -> None:
    at = np.array([2.0])
    assert guide.advise(at, 1, [0], "meta_controller", "meta_controller") == Advice(1, False, None)
    assert guide.advise(at, 3, [0], "meta_controller", "meta_controller") == Advice(3, True, None)
    assert guide.advise(at, 1, [0], "meta_controller", "demonstrations") == Advice(1, False, 4)
    assert guide.advise(at, 3, [0], "meta_controller", "demonstrations") == Advice(3, True, None)


def test_demonstrations_choose_the_skill_that_is_most_used_nearby(guide: Guide) -> None:
    # Frames 3, 13 and 15: skills 1, 2 and 1.
    assert guide.advise(np.array([3.0]), 0, [0], "demonstrations", "meta_controller") == Advice(1, False, None)
    assert guide.advise(np.array([3.0]), 0, [0], "demonstrations", "demonstrations") == Advice(1, False, 4)


def test_true_stages_leave_only_their_own_frames(guide: Guide) -> None:
    # In stage 0 the nearest are 2, 12 and 15 (skills 1, 0 and 1), in stage 1 they are 3, 13 and 16.
    assert guide.advise(np.array([3.0]), 0, [0], "stages", "demonstrations") == Advice(1, False, 4)
    assert guide.advise(np.array([2.1]), 0, [1], "stages", "demonstrations").goal == 4
    # It is far from there: what is done where the rollout is, among the nearest of all, tells whether it is foreign.
    assert guide.advise(np.array([0.0]), 2, [1], "stages", "demonstrations") == Advice(1, False, 4)
    assert replace(guide, neighbors=2).advise(np.array([0.0]), 2, [1], "stages", "demonstrations") == Advice(1, True, 4)
    # No stage is left, or none of its frames is there: as without stages, or as the meta controller has it.
    assert guide.advise(np.array([3.0]), 0, [], "stages", "meta_controller") == Advice(1, False, None)
    assert guide.advise(np.array([3.0]), 3, [7], "stages", "demonstrations") == Advice(3, True, None)
