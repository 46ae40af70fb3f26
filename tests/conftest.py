"""Keeps every test off the Hub and out of the user's folders; records the demonstrations that several tests read."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import settings

settings.register_profile("shared", deadline=None)  # a busy machine must not fail a test
settings.load_profile("shared")

# Read by LeRobot, MuJoCo and torch when they are imported.
_HOME = TemporaryDirectory(prefix="buds-tests-")  # removed when the interpreter ends
os.environ["HF_LEROBOT_HOME"] = _HOME.name
os.environ["HF_HUB_OFFLINE"] = "1"
os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("OMP_NUM_THREADS", "1")  # tiny tensors: threads would only wait for one another


@pytest.fixture(scope="session")
def demonstrations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four demonstrations from seeds 0 to 3, 32-pixel video, recorded by two workers. Not to be changed."""
    from lerobot_buds.cli.collect import CollectConfig, collect

    root = tmp_path_factory.mktemp("demonstrations") / "demos"
    summary = collect(
        CollectConfig(
            "tests/demos", episodes=4, root=str(root), workers=2, image_size=32, render_profile="fastest", video=True
        )
    )
    assert (summary.episodes, summary.attempts, summary.failures) == (4, 4, {})
    return root
