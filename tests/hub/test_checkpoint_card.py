"""A checkpoint that is shared with what is known of it."""

import json
from pathlib import Path

import pytest

from lerobot_buds.core import Segment, write_json
from lerobot_buds.evaluation.ribbon import draw_ribbons
from lerobot_buds.evaluation.trace import Decision, Episode, RolloutRecord

pytestmark = pytest.mark.slow

COMMAND = """
import sys
from lerobot_buds.cli.share import main
main()
"""


def test_diagnosis_and_ribbons_stand_on_the_card(hub, checkpoint: Path, tmp_path: Path):
    skills = (Segment(0, 20, 0), Segment(20, 40, 2))
    episodes = (Episode(1, True, "", skills, (Decision(0, 0, 0, False),), (20, 40)),)
    record = RolloutRecord({"failure_window_s": 10.0}, "test/task", ("reach", "grasp"), 20, 3, 5, episodes)
    record.write(tmp_path / "rollouts")
    draw_ribbons(tmp_path / "rollouts/ribbons.png", record)
    ids = {"right": 0.75, "right_near": None, "switches": 4.0, "switches_demonstrated": 5.0}
    write_json(tmp_path / "found.json", {"frames": 9, "errors": {"chosen": 0.5, "held": 0.25}, "skill_ids": ids})
    options = [f"--diagnosis={tmp_path / 'found.json'}", f"--rollouts={tmp_path / 'rollouts'}"]
    done = hub.run(COMMAND, f"--root={checkpoint}", "--repo_id=me/known", *options)
    assert done.returncode == 0, done.stderr[-3000:]
    card = hub.read("me/known/resolve/main/README.md").decode()
    assert "| chosen | 0.5000 |" in card and "75.0 % of the frames" in card and "4.0 switches" in card
    assert "| test/task | |" in card and "| episodes | 100%" in card and "](buds/ribbons.png)" in card
    files = {entry["path"] for entry in json.loads(hub.read("api/models/me/known/tree/main"))}
    assert {"buds/ribbons.png", "buds/diagnosis.json", "config.json", "model.safetensors", "README.md"} <= files
    assert not [name for name in files if not name.endswith((".json", ".safetensors", ".md", ".png"))]


def test_a_diagnosis_that_is_none_is_refused(hub, checkpoint: Path, tmp_path: Path):
    write_json(tmp_path / "found.json", [1, 2])
    options = [f"--diagnosis={tmp_path / 'found.json'}", "--repo_id=me/unknown"]
    done = hub.run(COMMAND, f"--root={checkpoint}", *options)
    assert done.returncode == 1 and "found.json holds no diagnosis" in done.stderr and "Traceback" not in done.stderr
