"""``lerobot-buds-report``: a file where it is wanted, and refusals in one line."""

import sys

import pytest

from lerobot_buds.cli import report


def run(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-report", *map(str, arguments)])
    report.main()


def test_it_writes_one_file(segmented, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run(monkeypatch, "--repo_id=tests/skills", f"--root={segmented}", "--episodes=[0, 2]")
    (file,) = [path for path in (tmp_path / "outputs/report").rglob("*") if path.is_file()]
    assert file.name == "skills.html" and "tests/skills: 3 skills" in file.read_text()
    assert "skills.html (" in capsys.readouterr().out


def test_a_dataset_that_is_not_segmented_is_refused(demonstrations, tmp_path, monkeypatch):
    with pytest.raises(SystemExit) as stop:
        run(monkeypatch, "--repo_id=tests/demos", f"--root={demonstrations}", f"--output={tmp_path / 'r.html'}")
    assert "has no segmentation record" in str(stop.value.code) and not (tmp_path / "r.html").exists()
