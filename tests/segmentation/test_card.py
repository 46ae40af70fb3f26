"""The card of a segmented dataset: its command makes the same settings again, and its names are text."""

import shlex
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np

from lerobot_buds.cli.running import parse
from lerobot_buds.cli.segment import SegmentConfig
from lerobot_buds.core import CARD_FILE, NAMES_FILE
from lerobot_buds.representation import RepresentationConfig
from lerobot_buds.segmentation import DiscoveryConfig, SegmentationRecord, write_card, write_names
from lerobot_buds.segmentation.card import rebuild_command

DISCOVERY = DiscoveryConfig(max_skills=3, window_s=0.25, search="levels", n_skills="auto")
REPRESENTATION = RepresentationConfig(cameras=["observation.images.a b"], image_size=32, proprioception=[])


def record(**changes: object) -> SegmentationRecord:
    description = {"parameters": asdict(DISCOVERY), "representation": {"hash": "ab", **asdict(REPRESENTATION)}}
    labels = [np.repeat([0, 1], 5)] * 2
    return SegmentationRecord.of_labels(labels, repo_id="me/it's", fps=10, horizon=8, **(description | changes))


def settings(made: SegmentationRecord, monkeypatch) -> SegmentConfig:
    monkeypatch.setattr(sys, "argv", shlex.split(rebuild_command(made)))
    return parse(SegmentConfig)


def test_the_command_on_the_card_makes_the_same_settings_again(monkeypatch) -> None:
    found = settings(record(chosen=[0, 3], commit="abc"), monkeypatch)
    assert (found.repo_id, found.revision, found.episodes) == ("me/it's", "abc", [0, 3])
    assert (found.discovery, found.representation) == (DISCOVERY, REPRESENTATION)
    assert found.subgoal_horizon_s == 0.8


def test_other_ways_to_labels_have_other_commands(monkeypatch) -> None:
    library = {"name": "/home/somebody/skills", "grown": True, "lineage": ["ab"]}
    found = settings(record(library=library), monkeypatch)
    assert (found.library, found.grow, found.discovery) == ("skills", True, DiscoveryConfig())
    found = settings(record(labels_from="subtasks"), monkeypatch)
    assert (found.labels_from, found.discovery, found.representation) == ("subtasks", DiscoveryConfig(), REPRESENTATION)
    fetched = {"hash": "ab", "repo_id": "me/network", "commit": "cd"}
    assert settings(record(representation=fetched), monkeypatch).representation_path == "me/network"


def test_names_on_the_card_are_text(tmp_path: Path) -> None:
    record().write(tmp_path)
    write_names(tmp_path / NAMES_FILE, ["<img src=x onerror=alert(1)>", "a | b\n## c"])
    write_card(tmp_path, "me/skills")
    text = (tmp_path / CARD_FILE).read_text()
    assert "<img" not in text and "## c" not in text
    (line,) = [line for line in text.splitlines() if line.startswith("| 1 |")]
    assert line == "| 1 | a &#124; b &#35;&#35; c | 2 | 0.5 s |"
    assert (tmp_path / "meta/buds/timeline.png").stat().st_size > 1000
