"""What the installed LeRobot says when episodes begin and end is what the robot listens for."""

import ast
import inspect
import logging

import pytest
from lerobot.rollout.strategies import core, dagger, episodic
from lerobot.scripts import lerobot_record

from lerobot_buds.teleoperation.announcements import Announcement, Announcements, understood

SAID_BY = {
    Announcement.EPISODE: (lerobot_record, episodic),
    Announcement.RESET: (lerobot_record, episodic),
    Announcement.POLICY: (core,),
    Announcement.CORRECTIONS: (dagger,),
    Announcement.PAUSE: (dagger,),
    Announcement.CORRECTION: (dagger,),
    Announcement.CORRECTION_SAVED: (dagger,),
    Announcement.RESUME: (dagger,),
}


def messages_of(module):
    """Beginnings of the texts that a module logs."""
    calls = [node for node in ast.walk(ast.parse(inspect.getsource(module))) if isinstance(node, ast.Call)]
    for call in calls:
        name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
        if name in ("info", "log_say") and call.args:
            text = call.args[0].values[0] if isinstance(call.args[0], ast.JoinedStr) else call.args[0]
            if isinstance(text, ast.Constant):
                yield str(text.value)


@pytest.mark.parametrize("announcement", Announcement)
def test_the_installed_lerobot_says_it(announcement):
    for module in SAID_BY[announcement]:
        texts = list(messages_of(module))
        assert any(text.startswith(announcement.value) for text in texts), (module.__name__, texts)


@pytest.mark.parametrize(
    ("message", "meaning"),
    [
        ("Recording episode 12", (Announcement.EPISODE, 12)),
        ("Recording episode", None),
        ("Recording episode of twelve", None),
        ("Reset the environment", (Announcement.RESET, None)),
        ("Correction 3 saved", (Announcement.CORRECTION_SAVED, None)),
        ("Correction 3/5 saved", None),
        ("DAgger strategy ready (input=keyboard, episodes=5)", (Announcement.CORRECTIONS, None)),
        ("Exiting", None),
    ],
)
def test_messages_mean_what_they_say(message, meaning):
    assert understood(message) == meaning


def test_they_wait_in_order_until_asked_for(caplog):
    caplog.set_level(logging.INFO)
    announcements = Announcements()
    assert announcements.listen()
    logging.info("Recording episode %d", 0)
    logging.getLogger("somebody.else").info("Recording episode 7")
    logging.getLogger("lerobot.rollout").info("Resuming autonomous mode - resetting engine and interpolator")
    announcements.stop()
    logging.info("Reset the environment")
    assert announcements.heard() == [(Announcement.EPISODE, 0), (Announcement.RESUME, None)]
    assert announcements.heard() == []


def test_a_log_that_is_off_is_noticed(caplog):
    caplog.set_level(logging.WARNING)
    announcements = Announcements()
    assert not announcements.listen()
    announcements.stop()
