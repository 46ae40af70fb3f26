"""Presses keys on the X display of this process and prints what LeRobot's listener heard; run by test_keys."""

import os
import sys
import time

from lerobot.utils.keyboard_input import init_keyboard_listener

from lerobot_buds.teleoperation.keys import keyboard

keyboard().open()
assert not os.isatty(0)  # a display is read, and standard input is left alone
listener, events = init_keyboard_listener()
listener.wait()
for name in ("next", "re-record", "stop"):
    assert keyboard().press(name)
patience = time.monotonic() + 5
while not all(events.values()) and time.monotonic() < patience:
    time.sleep(0.01)
keyboard().release()
listener.stop()
sys.stdout.write(f"HEARD {sorted(name for name, heard in events.items() if heard)}\n")
