"""The demonstrator's motions, on worlds simple enough to know what must happen."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_buds.demos.attempts import attempt
from lerobot_buds.demos.motions import Demonstrator, MotionFailedError, Traits, draw_traits
from lerobot_buds.demos.stages import STAGES

TASK = "multitask_kitchen/task3_variant1"
AT_ONCE = 0.0133  # metres that the real hand moves per step at an action of 1


class StillWorld:
    """A world in which nothing ever moves; the drawer is open and the pot far from the region."""

    slide = -0.1
    pot = np.array([0.03, 0.0, 0.9])

    def __init__(self):
        self.hand = np.array([-0.1, 0.0, 1.0])

    def position(self, body):
        return self.pot

    def point_on(self, body, local):
        return np.array([0.0, -0.2, 0.98])

    def joint(self, name):
        return self.slide

    def obey(self, action):
        """Does nothing with an action."""


class FreeWorld(StillWorld):
    """A world of an obedient hand, where drawer and pot are already where they belong."""

    slide = 0.0
    pot = np.array([0.16, 0.0, 0.9])

    def obey(self, action):
        self.hand = self.hand + AT_ONCE * action[:3].astype(np.float64)


class Stub:
    """What `attempt` needs of an environment, around such a world; its goal never holds."""

    task = TASK

    def __init__(self, world):
        self.state = world

    def reset(self, seed):
        return self._observation(), {}

    def executed(self, action):
        return action

    def step(self, action):
        self.state.obey(action)
        return self._observation(), 0.0, False, False, {}

    def _observation(self):
        return {"pixels": {"agentview": np.zeros((2, 2, 3), np.uint8)}, "agent_pos": self.state.hand}


def demonstrator(world, seed=0, closed=False):
    hand = Demonstrator(world, np.random.default_rng(seed))
    hand.closed = closed
    return hand


def drive(world, motion):
    """Executes a motion to its end; returns its actions."""
    actions = []
    for action in motion:
        world.obey(action)
        actions.append(action)
    return np.array(actions)


@pytest.mark.parametrize("seed", range(5))
def test_a_motion_arrives_with_bounded_actions(seed):
    world = FreeWorld()
    target = np.array([0.1, -0.15, 0.95])
    actions = drive(world, demonstrator(world, seed, closed=True).move(lambda: target, tolerance=0.02))
    assert np.linalg.norm(world.hand - target) < 0.02
    assert actions.dtype == np.float32 and np.abs(actions).max() <= 1
    assert (actions[:, 3] == 1).all()
    assert 20 < len(actions) < 150


def test_a_motion_follows_a_target_that_moves():
    world = FreeWorld()
    target = np.array([0.05, 0.0, 1.0])

    def fleeing():
        target[1] += 0.002
        return target.copy()

    drive(world, demonstrator(world).move(fleeing))
    assert target[1] > 0.02 and np.linalg.norm(world.hand - target) < 0.014


def test_a_condition_replaces_the_tolerance():
    world = FreeWorld()
    motion = demonstrator(world).move(lambda: np.array([1.0, 0.0, 1.0]), until=lambda: world.hand[0] > 0)
    drive(world, motion)
    assert 0 < world.hand[0] < 0.02


def test_a_held_hand_stays_and_works_the_gripper():
    world = FreeWorld()
    before = world.hand
    actions = drive(world, demonstrator(world).hold(20))
    assert len(actions) == 20 and (actions[:, 3] == -1).all()
    assert np.linalg.norm(world.hand - before) < 0.02


def test_the_manner_sets_the_speed():
    lengths = []
    for speed in (0.3, 0.6):
        world = FreeWorld()
        hand = demonstrator(world)
        hand.traits = Traits(speed=speed, tremor=0.0, curve=0.0, hesitation=0.0)
        lengths.append(len(drive(world, hand.move(lambda: np.array([0.1, 0.1, 1.1]), 0.02))))
    assert lengths[0] > 1.5 * lengths[1]


def test_a_motion_that_cannot_arrive_fails():
    world = StillWorld()
    with pytest.raises(MotionFailedError, match="did not arrive within 12 seconds"):
        drive(world, demonstrator(world).move(lambda: np.zeros(3)))
    with pytest.raises(MotionFailedError):
        drive(world, STAGES["close_drawer"](demonstrator(world)))


def test_a_failed_motion_is_a_failed_attempt_with_its_stage_and_reason():
    result = attempt(Stub(StillWorld()), seed=4)
    assert (result.seed, result.success, result.arrays) == (4, False, {})
    assert result.failure == "close_drawer: the hand did not arrive within 12 seconds"


def test_an_attempt_fails_whose_goal_does_not_hold_at_the_end():
    result = attempt(Stub(FreeWorld()), seed=0)
    assert not result.success and not result.arrays
    assert result.failure == "push_pot: the goal does not hold at the end"


@given(st.integers(0, 2**32 - 1))
def test_manners_are_human(seed):
    traits = draw_traits(np.random.default_rng(seed))
    assert 0.33 <= traits.speed <= 0.625  # the SpaceMouse's limit
    assert 0 < traits.tremor < 0.1 and 0 <= traits.curve <= 0.25 and 0 <= traits.hesitation < 1


def test_a_seed_decides_a_motion():
    def actions(seed):
        world = FreeWorld()
        return drive(world, demonstrator(world, seed).move(lambda: np.array([0.1, 0.0, 1.0]), tolerance=0.02))

    np.testing.assert_array_equal(actions(1), actions(1))
    assert not np.array_equal(actions(1)[:10], actions(2)[:10])
