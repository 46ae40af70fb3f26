"""``lerobot-buds-report``: a file where it is wanted, and refusals in one line."""

import json
import re
import sys

import pytest

from lerobot_buds.cli import report
from lerobot_buds.cli.segment import segment


def run(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-report", *map(str, arguments)])
    report.main()


def test_it_writes_one_file(segmented, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run(monkeypatch, "--repo_id=tests/skills", f"--root={segmented}", "--episodes=[0, 2]")
    (file,) = [path for path in (tmp_path / "outputs/report").rglob("*") if path.is_file()]
    assert file.name == "skills.html" and "tests/skills: 3 skills" in file.read_text()
    assert "skills.html (" in capsys.readouterr().out


def test_a_recording_for_rerun_is_written_beside_it(segmented, tmp_path, monkeypatch, capsys):
    arguments = ["--repo_id=tests/skills", f"--root={segmented}", "--episodes=[1]", f"--output={tmp_path / 'r.html'}"]
    run(monkeypatch, *arguments, f"--rerun={tmp_path / 'r.rrd'}")
    assert (tmp_path / "r.rrd").read_bytes()[:4] == b"RRF2"
    assert "r.rrd (" in capsys.readouterr().out
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(SystemExit) as stop:
        run(monkeypatch, *arguments[:-1], f"--output={tmp_path / 's.html'}", f"--rerun={tmp_path / 's.rrd'}")
    assert "needs rerun" in str(stop.value.code) and not (tmp_path / "s.html").exists()


def test_a_dataset_that_is_not_segmented_is_refused(demonstrations, tmp_path, monkeypatch):
    with pytest.raises(SystemExit) as stop:
        run(monkeypatch, "--repo_id=tests/demos", f"--root={demonstrations}", f"--output={tmp_path / 'r.html'}")
    assert "has no segmentation record" in str(stop.value.code) and not (tmp_path / "r.html").exists()


def test_somebody_elses_dataset_has_its_own_shape(make_dataset, settings, tmp_path, monkeypatch):
    """Wide frames, no state, no stages, no record of how it was collected; two tasks."""
    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path / "home"))
    source = make_dataset(
        tmp_path / "source",
        cameras={"observation.images.front": (24, 40, 3)},
        state={"shape": ()},
        tasks=("sort", "<b>stack</b>"),
        video=True,
    )
    segment(settings(source, tmp_path, representation={"image_size": 16, "proprioception": []}))
    run(monkeypatch, "--repo_id=tests/foreign", f"--root={tmp_path / 'skills'}", f"--output={tmp_path / 'report.html'}")
    page = (tmp_path / "report.html").read_text()
    data = json.loads(re.search('(?s)id="data">(.*?)</script>', page)[1])
    assert data["cameras"] == [{"name": "observation.images.front", "size": [40, 24]}]
    assert [demo["tasks"] for demo in data["demonstrations"]] == [["sort"], ["<b>stack</b>"]]
    assert data["stages"] == {} and 'id="agreement"' not in page and "<b>stack" not in page
