"""The motions, tried on a hand that moves as told and a block that it holds."""

from collections.abc import Iterable

import numpy as np
import pytest
from numpy.typing import NDArray

from lerobot_buds.demos.motions import Action, Demonstrator, MotionFailedError
from lerobot_buds.demos.vocabulary import approach, carry, draw_back, grasp, lift, push, release, sweep, up

Vec = NDArray[np.float64]
SEEDS = range(8)


class Bench:
    """A hand that moves a quarter of what an action aims at; while `held`, the block keeps its offset to it."""

    def __init__(self, seed: int) -> None:
        self.hand: Vec = np.array([0.0, 0.0, 1.0])
        self.block: Vec = np.array([0.1, 0.05, 0.9])
        self.held = False
        self.stuck = False
        self.demonstrator = Demonstrator(self, np.random.default_rng(seed))
        self.path: list[Vec] = [self.hand]
        self.grips: list[float] = []

    def position(self, body: str) -> Vec:
        return self.block

    def point_on(self, body: str, local: Vec) -> Vec:
        return self.block + local

    def joint(self, name: str) -> float:
        return 0.0

    def run(self, motion: Iterable[Action]) -> None:
        for action in motion:
            step = np.zeros(3) if self.stuck else 0.25 * 0.05 * action[:3]
            self.hand = self.hand + step
            if self.held:
                self.block = self.block + step
            self.path.append(self.hand)
            self.grips.append(float(action[3]))


@pytest.mark.parametrize("seed", SEEDS)
def test_grasp_comes_down_open_and_ends_closed_at_the_point(seed: int) -> None:
    bench = Bench(seed)
    bench.demonstrator.closed = True
    bench.run(grasp(bench.demonstrator, lambda: bench.block, spread=(0.0, 0.0, 0.0)))
    assert np.linalg.norm(bench.hand - bench.block) < 0.012
    closing = bench.grips.index(1.0)
    assert bench.grips == [-1.0] * closing + [1.0] * (len(bench.grips) - closing)
    assert len(bench.grips) - closing >= 10
    beside = [p for p in bench.path[1:] if p[2] < 0.92]
    assert all(np.linalg.norm(p[:2] - bench.block[:2]) < 0.025 for p in beside)


def test_grasps_differ_within_their_spread() -> None:
    ends = []
    for seed in range(30):
        bench = Bench(seed)
        bench.run(grasp(bench.demonstrator, lambda bench=bench: bench.block, spread=(0.03, 0.0, 0.0)))
        ends.append(bench.hand - bench.block)
    spread = np.std(ends, axis=0)
    assert spread[0] > 0.012
    assert spread[1] < 0.006


@pytest.mark.parametrize("seed", SEEDS)
def test_approach_ends_above_the_point(seed: int) -> None:
    bench = Bench(seed)
    bench.run(approach(bench.demonstrator, lambda: bench.block, hover=(0.05, 0.06)))
    np.testing.assert_allclose(bench.hand, bench.block + up(0.055), atol=0.022)


@pytest.mark.parametrize("seed", SEEDS)
def test_carry_brings_the_body_itself_to_the_goal(seed: int) -> None:
    bench = Bench(seed)
    bench.held = True
    goal = np.array([-0.1, 0.2, 1.0])
    bench.run(carry(bench.demonstrator, "block_main", lambda: goal, tolerance=0.01))
    assert np.linalg.norm(bench.block - goal) < 0.012
    assert np.linalg.norm(bench.hand - goal) > 0.05


@pytest.mark.parametrize("seed", SEEDS)
def test_lift_release_and_draw_back_go_as_far_as_they_say(seed: int) -> None:
    bench = Bench(seed)
    bench.demonstrator.closed = True
    bench.run(lift(bench.demonstrator, 0.1))
    assert 1.08 < bench.hand[2] < 1.14
    assert set(bench.grips) == {1.0}
    before = bench.hand
    bench.run(release(bench.demonstrator, rise=0.05))
    assert bench.grips[-1] == -1.0
    assert bench.hand[2] > before[2] + 0.03
    before = bench.hand
    bench.run(draw_back(bench.demonstrator, (-0.11, 0.0, 0.0), (-0.09, 0.0, 0.0)))
    np.testing.assert_allclose(bench.hand - before, [-0.1, 0.0, 0.0], atol=0.037)


@pytest.mark.parametrize("seed", SEEDS)
def test_sweep_goes_straight_until_it_is_done(seed: int) -> None:
    bench = Bench(seed)
    bench.run(sweep(bench.demonstrator, (0.0, 1.0, 0.0), until=lambda: bench.hand[1] > 0.2))
    path = np.array(bench.path)
    assert 0.2 < path[-1, 1] < 0.22
    assert np.abs(path[:, [0, 2]] - (0.0, 1.0)).max() < 0.03
    assert np.abs(path[-1, [0, 2]] - (0.0, 1.0)).max() < 0.02


def test_push_closes_the_hand_first_and_follows_what_moves_sideways() -> None:
    bench = Bench(0)

    def start() -> Vec:
        aside = 0.05 if bench.hand[0] > 0.1 else 0.0
        return np.array([0.0, 0.1 + aside, 0.9])

    bench.run(push(bench.demonstrator, start, (1.0, 0.0, 0.0), until=lambda: bench.hand[0] > 0.3))
    assert set(bench.grips) == {1.0}
    assert bench.hand[1] == pytest.approx(0.15, abs=0.015)


def test_a_hand_that_is_stuck_gives_up() -> None:
    bench = Bench(0)
    bench.stuck = True
    with pytest.raises(MotionFailedError, match="did not arrive"):
        bench.run(lift(bench.demonstrator, 0.1))
