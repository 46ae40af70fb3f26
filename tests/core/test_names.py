import pytest

from lerobot_buds.core import OUR_ACTION, OUR_STATE, ConfigError, dims_used, same_rate
from lerobot_buds.envs import ACTION_NAMES, STATE_NAMES

SO101 = ["shoulder_pan.pos", "wrist_roll.pos", "gripper.pos"]


def test_our_environments_are_known_by_all_their_names():
    assert list(OUR_STATE) == STATE_NAMES and list(OUR_ACTION) == ACTION_NAMES


def test_patterns_are_the_users_or_those_of_our_own_state():
    assert dims_used("x", SO101, None, ours=["gripper*"]) == [0, 1, 2]
    assert dims_used("x", SO101, None, ours=["gripper*"], others=[]) == []
    assert dims_used("x", OUR_STATE, None, ours=["gripper*"]) == [7, 8]
    assert dims_used("x", OUR_STATE[:-1], None, ours=["gripper*"]) == list(range(11))
    assert dims_used("x", SO101, ["*roll*", "gripper*"], ours=["*"]) == [1, 2]
    assert dims_used("x", SO101, [], ours=["*"]) == []


def test_a_pattern_without_a_match_is_refused_with_the_names_there_are():
    with pytest.raises(ConfigError, match=r"proprioception: 'griper.pos'.*Did you mean 'gripper.pos'"):
        dims_used("proprioception", SO101, ["wrist*", "griper.pos"], ours=["*"])


@pytest.mark.parametrize(
    ("one", "other", "same"), [(29.97, 30000 / 1001, True), (29.97, 30, False), (20, 20.0, True), (12.5, 12, False)]
)
def test_rates_are_compared_with_a_tolerance(one, other, same):
    assert same_rate(one, other) is same_rate(other, one) is same
