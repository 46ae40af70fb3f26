"""The figures of movement, on paths whose figures are known."""

import numpy as np
import pytest

from lerobot_buds.demos.movement import (
    measure,
    near_contact,
    pauses_in,
    reversals,
    spectral_arc_length,
    table,
    velocity,
    ways,
)

FPS = 20
OPEN = np.zeros(100, dtype=np.int64)


def path_of(*legs: tuple[float, float, float]) -> np.ndarray:
    """Walks legs (m/s along x and y, s), frame by frame."""
    steps = [np.tile([x / FPS, y / FPS, 0.0], (round(s * FPS), 1)) for x, y, s in legs]
    return np.concatenate([np.zeros((1, 3)), *steps]).cumsum(axis=0)


def test_a_steady_motion_has_one_speed_and_no_pause() -> None:
    path = path_of((0.1, 0.0, 10.0))
    found = measure([(path, np.zeros(len(path), dtype=np.int64))], FPS)
    assert (found.speed_p10, found.speed_p50, found.speed_p90) == pytest.approx((0.1, 0.1, 0.1))
    assert (found.paused, found.pauses, found.corrections, found.flips, found.brief_grips) == (0, 0, 0, 0, 0)
    assert found.detour == pytest.approx(1.0)


def test_pauses_are_counted_from_0_3_s_on() -> None:
    path = path_of((0.1, 0.0, 2.0), (0.0, 0.0, 1.0), (0.1, 0.0, 2.0), (0.0, 0.0, 0.2), (0.1, 0.0, 0.8))
    speed = np.linalg.norm(velocity(path, FPS), axis=1)
    ((start, end),) = pauses_in(speed, FPS)
    assert start == pytest.approx(40, abs=3) and end == pytest.approx(60, abs=3)
    found = measure([(path, np.zeros(len(path), dtype=np.int64))], FPS)
    assert found.pauses == pytest.approx(60 / 6.05) and found.paused == pytest.approx(1 / 6, abs=0.04)


def test_reversals_count_and_corners_do_not() -> None:
    back_and_forth = path_of(*[(0.1, 0.0, 1.0), (-0.1, 0.0, 1.0)] * 3)
    assert reversals(velocity(back_and_forth, FPS), FPS) == 5
    stairs = path_of(*[(0.1, 0.0, 1.0), (0.0, 0.1, 1.0)] * 3)
    assert reversals(velocity(stairs, FPS), FPS) == 0


def test_a_smooth_reach_is_smoother_than_two_and_than_a_noisy_one() -> None:
    t = np.linspace(0, 1, 41)
    bell = 30 * t**2 * (1 - t) ** 2
    one = spectral_arc_length(bell, FPS)
    assert -1.7 < one < -1.3  # a minimum-jerk reach
    assert spectral_arc_length(np.concatenate([bell, bell]), FPS) < one - 0.5
    noisy = bell + np.random.default_rng(0).uniform(0, 1, 41)
    assert spectral_arc_length(noisy, FPS) < one - 0.3
    assert spectral_arc_length(3 * bell, FPS) == pytest.approx(one)


def test_flips_and_grips_that_were_taken_back() -> None:
    path = path_of((0.1, 0.0, 10.0))
    closed = np.zeros(len(path), dtype=np.int64)
    closed[20:40] = 1  # one second
    closed[80:160] = 1  # four
    found = measure([(path, closed)], FPS)
    assert (found.flips, found.brief_grips) == (4, 1)
    twice = measure([(path, closed), (path, np.zeros(len(path), dtype=np.int64))], FPS)
    assert (twice.flips, twice.brief_grips) == (2, 0.5)


def test_the_detour_is_between_changes_of_the_gripper() -> None:
    path = path_of((0.1, 0.0, 2.0), (0.0, 0.1, 2.0))
    closed = np.zeros(len(path), dtype=np.int64)
    walked, straight = ways(path, closed)
    assert walked / straight == pytest.approx(np.sqrt(2))
    closed[40:] = 1  # at the corner
    walked, straight = ways(path, closed)
    assert walked / straight == pytest.approx(1.0)


def test_near_contact_is_about_changes_of_the_gripper() -> None:
    path = path_of((0.1, 0.0, 10.0))
    closed = np.zeros(len(path), dtype=np.int64)
    closed[100:] = 1  # at x = 0.5 m
    near = near_contact(path, closed)
    assert np.flatnonzero(near)[[0, -1]] == pytest.approx([91, 109], abs=1) and near[91:109].all()
    assert not near_contact(path[:100], OPEN).any()


def test_speeds_near_contact_are_held_against_those_elsewhere() -> None:
    path = path_of((0.1, 0.0, 4.5), (0.02, 0.0, 4.0), (0.1, 0.0, 4.5))
    closed = np.zeros(len(path), dtype=np.int64)
    closed[130:] = 1
    assert measure([(path, closed)], FPS).near_speed == pytest.approx(0.2, abs=0.02)


def test_the_table_has_a_row_each() -> None:
    path = path_of((0.1, 0.0, 5.0))
    found = measure([(path, np.zeros(len(path), dtype=np.int64))], FPS)
    lines = table({"one": (1, found), "two": (2, found)}).splitlines()
    assert len(lines) == 4 and lines[2].startswith("| one | 1 | 0.100 | 0.100 | 0.100 | 0 % | 0.0 |")
    assert len({line.count("|") for line in lines}) == 1
