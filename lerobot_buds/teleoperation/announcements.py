"""What LeRobot's commands say of an episode's begin and end: in their log, and nowhere else.

A robot is told actions only. Its user hears "Recording episode 3" and sets up the scene again; so does this robot. The
texts are those of LeRobot 0.6.1; a test compares them with the installed one.
"""

import logging
import re
from collections import deque
from enum import Enum


class Announcement(Enum):
    """What is announced; the value is what LeRobot's message begins with."""

    EPISODE = "Recording episode "
    """An episode is recorded from now on; the number of episodes that are saved follows."""

    RESET = "Reset the environment"
    """Nothing is recorded now: the time to set up the scene again."""

    POLICY = "Inference engine started"
    """A policy acts, not a person: this is a rollout."""

    CORRECTIONS = "DAgger strategy ready"
    """A person may take over from the policy, and what the person does is recorded."""

    PAUSE = "Pausing engine - robot holds position"
    """The policy was stopped for a person to take over. LeRobot goes on sending its last action."""

    CORRECTION = "Entering correction mode"
    """A person acts, and is recorded."""

    CORRECTION_SAVED = "Correction "
    """A correction has ended and is an episode of the dataset; the robot is paused again."""

    RESUME = "Resuming autonomous mode"
    """The policy acts again."""


_SAVED = re.compile(r"Correction \d+ saved$")


def understood(message: str) -> tuple[Announcement, int | None] | None:
    """Tells what a message of LeRobot's announces, and the number in it; None where it announces nothing.

    Args:
        message: The text.
    """
    for kind in Announcement:
        if not message.startswith(kind.value):
            continue
        rest = message.removeprefix(kind.value)
        if kind is Announcement.EPISODE:
            return (kind, int(rest)) if rest.isdecimal() else None
        if kind is Announcement.CORRECTION_SAVED and not _SAVED.match(message):
            continue
        return kind, None
    return None


class Announcements(logging.Handler):
    """Listens to LeRobot's log. What was heard waits until it is asked for, so that nothing is done amid a log line."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self._heard: deque[tuple[Announcement, int | None]] = deque()

    def listen(self) -> bool:
        """Begins to listen; returns whether there is anything to hear, which a quieter log would swallow."""
        root = logging.getLogger()
        root.addHandler(self)
        return root.isEnabledFor(logging.INFO)

    def stop(self) -> None:
        """Ends listening; may be called twice."""
        logging.getLogger().removeHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Keeps what LeRobot announces; it speaks through the root logger, too."""
        if (record.name == "root" or record.name.startswith("lerobot.")) and (said := understood(record.getMessage())):
            self._heard.append(said)

    def heard(self) -> list[tuple[Announcement, int | None]]:
        """Returns what was announced since it was last asked for, first to last, with the numbers in it."""
        return [self._heard.popleft() for _ in range(len(self._heard))]
