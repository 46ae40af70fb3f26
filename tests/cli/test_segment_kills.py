"""Kills at random moments: the experiment of ``scripts/kill_segmentation.py``, smaller."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

CHECKOUT = Path(__file__).parents[2]


def test_killed_passes_lose_nothing_and_end_as_unbroken_ones():
    sizes = ["--kills=5", "--episodes=2", "--frames=30", "--image_size=32", "--steps=6", "--checkpoint_interval=2"]
    done = subprocess.run(
        [sys.executable, "scripts/kill_segmentation.py", *sizes],
        cwd=CHECKOUT,
        env={**os.environ, "PYTHONPATH": str(CHECKOUT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(re.findall(r"^kill \d after .* s, \w+: whole$", done.stdout, re.MULTILINE)) == 5
    assert done.stdout.splitlines()[-1].split() == ["all", "5", "of", "5", "whole"]
