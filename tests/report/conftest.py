"""Segmentations to report on: one made by hand, without cameras, and the small recorded one."""

from types import SimpleNamespace

import numpy as np
import pytest

from lerobot_buds.data import LocalDataset
from lerobot_buds.report import Content
from lerobot_buds.report.content import Structure
from lerobot_buds.segmentation import SegmentationRecord, TaskStructure

LABELS = [[0] * 4 + [1] * 6, [0] * 2 + [2] * 4 + [1] * 2, [0] * 2 + [1] * 8]
STAGES = [[0] * 5 + [1] * 5, [0] * 2 + [1] * 6, [0] * 2 + [1] * 8]


@pytest.fixture
def content():
    """Three demonstrations of 10, 8 and 10 frames at 10 Hz, with three skills, two stages and two tasks."""
    labels = [np.array(x) for x in LABELS]
    structure = Structure(
        TaskStructure(
            np.array([[0, 4], [4, 7], [7, 10], [4, 10], [0, 10]]),
            np.array([[-1, -1], [-1, -1], [-1, -1], [1, 2], [0, 3]]),
        ),
        np.array([[0, 4], [4, 10]]),
    )
    whole = Structure(TaskStructure(np.array([[0, 8]]), np.array([[-1, -1]])), np.array([[0, 8]]))
    return Content(
        dataset=SimpleNamespace(fps=10.0, cameras=[]),
        record=SegmentationRecord.of_labels(labels, repo_id="me/source", fps=10.0, horizon=5, stability=0.9),
        collection={"stages": ["open_drawer", "close_drawer"], "demonstrator": "scripted"},
        numbers=[0, 1, 2],
        starts=[0, 10, 18],
        labels=labels,
        tasks=[("tidy up",), ("tidy up",), ("make tea",)],
        stages=[np.array(x) for x in STAGES],
        structures=[structure, whole, structure],
        side=32,
    )


@pytest.fixture(scope="session")
def recorded(segmented):
    return Content.read(LocalDataset(segmented))
