"""Keeps every test off the Hub and out of the user's folders; LeRobot reads both variables when it is imported."""

import os
from tempfile import TemporaryDirectory

_HOME = TemporaryDirectory(prefix="buds-tests-")  # removed when the interpreter ends
os.environ["HF_LEROBOT_HOME"] = _HOME.name
os.environ["HF_HUB_OFFLINE"] = "1"
