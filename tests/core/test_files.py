import json
from pathlib import Path

import pytest

from lerobot_buds.core import near_names, read_json, sha256_of_file, staged_directory, write_atomically, write_json


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json(path, {"old": 1})

    def fail(part: Path) -> None:
        part.write_text("half")
        raise RuntimeError("killed")

    with pytest.raises(RuntimeError):
        write_atomically(path, fail)
    assert read_json(path) == {"old": 1}
    assert list(tmp_path.iterdir()) == [path]


def test_json_is_canonical_and_refuses_nan(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"b": 1, "a": [2]})
    write_json(tmp_path / "b.json", {"a": [2], "b": 1})
    assert sha256_of_file(tmp_path / "a.json") == sha256_of_file(tmp_path / "b.json")
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": [2], "b": 1}
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "a.json", float("nan"))


def test_a_staged_directory_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    target = tmp_path / "sub" / "data"
    with pytest.raises(RuntimeError), staged_directory(target) as staging:
        staging.mkdir()
        (staging / "x").write_text("half")
        raise RuntimeError
    assert list(target.parent.iterdir()) == []
    with staged_directory(target) as staging:
        staging.mkdir()
        (staging / "x").write_text("whole")
        assert not target.exists()
    assert (target / "x").read_text() == "whole"
    assert list(target.parent.iterdir()) == [target]


def test_near_names_puts_the_nearest_first() -> None:
    message = near_names("kichen", ["hammer", "kitchen"])
    assert message == "Did you mean 'kitchen'? Known: 'kitchen', 'hammer'."
    assert near_names("x", []) == "Known: none."
