"""Settings that several tests share."""

from typing import Any

import pytest


@pytest.fixture(scope="session")
def small() -> dict[str, Any]:
    """Sizes of small networks, as settings of `BudsConfig`."""
    return {
        "device": "cpu",
        "encoder": "conv",
        "norm": "group",
        "conv_channels": [8, 8],
        "keypoints": 8,
        "head_widths": [32],
        "subgoal_dim": 8,
    }
