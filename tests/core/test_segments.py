import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_buds.core import Segment, frames_of_seconds, labels_of, segments_of, select_dims, subgoals_of

label_arrays = st.lists(st.integers(0, 3), max_size=60).map(lambda x: np.array(x, dtype=np.int64))


@given(label_arrays)
def test_segments_tile_and_neighbours_differ(labels: np.ndarray) -> None:
    segments = segments_of(labels)
    edges = [0, *(s.end for s in segments)]
    assert [s.start for s in segments] == edges[:-1]
    assert edges[-1] == len(labels)
    assert all(a.label != b.label for a, b in itertools.pairwise(segments))
    np.testing.assert_array_equal(labels_of(segments), labels)


@given(label_arrays, st.integers(1, 20))
def test_subgoals_obey_their_formula(labels: np.ndarray, horizon: int) -> None:
    subgoals = subgoals_of(labels, horizon)
    for segment in segments_of(labels):
        for t in range(segment.start, segment.end):
            assert subgoals[t] == min(t + horizon, segment.end, len(labels) - 1)


def test_boundary_frame_belongs_to_the_later_segment() -> None:
    labels = np.array([4, 4, 4, 1, 1])
    assert segments_of(labels) == [Segment(0, 3, 4), Segment(3, 5, 1)]
    assert subgoals_of(labels, 10).tolist() == [3, 3, 3, 4, 4]


@pytest.mark.parametrize(("seconds", "fps", "frames"), [(0.5, 20, 10), (0.0, 20, 1), (1.5, 30, 45), (0.01, 20, 1)])
def test_frames_of_seconds(seconds: float, fps: int, frames: int) -> None:
    assert frames_of_seconds(seconds, fps) == frames


def test_select_dims_matches_patterns_in_order() -> None:
    names = ["joint_1.pos", "gripper_left.pos", "Gripper", "eef_x.pos"]
    assert select_dims(names, ["eef*", "gripper*"]) == [1, 3]
    assert select_dims(names, ["wheel*"]) == []
