"""Keys are held as long as a page says so."""

import pytest

from lerobot_buds.teleoperation.held_keys import FORGOTTEN_S, MOST_PAGES, HeldKeys


@pytest.fixture
def time():
    return [100.0]


@pytest.fixture
def keys(time):
    return HeldKeys({"w", "a"}, lambda: time[0])


def test_a_key_is_let_go_when_its_page_says_so_or_nothing(keys, time):
    keys.say("one", 0, ["w", "x", "w"])
    assert keys.now() == {"w"}
    time[0] += 0.9 * FORGOTTEN_S
    keys.say("one", 1, ["w", "a"])
    time[0] += 0.9 * FORGOTTEN_S
    assert keys.now() == {"w", "a"}
    time[0] += 0.2 * FORGOTTEN_S
    assert keys.now() == set()
    keys.say("one", 2, ["a"])
    keys.say("one", 3, [])
    assert keys.now() == set()


def test_what_comes_late_does_not_count(keys, time):
    keys.say("one", 5, [])
    keys.say("one", 4, ["w"])
    assert keys.now() == set()
    time[0] += 10 * FORGOTTEN_S
    keys.say("one", 3, ["w"])
    assert keys.now() == set()


def test_pages_do_not_let_go_what_others_hold(keys):
    keys.say("one", 9, ["w"])
    keys.say("two", 0, ["a"])
    keys.say("two", 1, [])
    assert keys.now() == {"w"}


def test_pages_are_not_remembered_without_end(keys):
    for page in range(1000):
        keys.say(str(page), 0, ["w"])
    assert len(keys._said) == MOST_PAGES and "999" in keys._said
