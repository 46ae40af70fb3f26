import json
from pathlib import Path

import pytest

from lerobot_buds.core import (
    BudsError,
    DatasetError,
    StorageError,
    near_names,
    read_json,
    refuse_newer,
    remove_leftovers,
    replaced_together,
    sha256_of_file,
    staged_directory,
    storage_errors,
    write_atomically,
    write_json,
)


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


def test_what_cannot_be_written_is_said(tmp_path: Path) -> None:
    def fill_the_disk(part: Path) -> None:
        part.write_text("half")
        raise OSError(28, "No space left on device")

    write_json(tmp_path / "a.json", {"old": 1})
    with pytest.raises(StorageError, match=r"a\.json could not be written \(.*No space left on device\).*Make room"):
        write_atomically(tmp_path / "a.json", fill_the_disk)
    assert read_json(tmp_path / "a.json") == {"old": 1} and len(list(tmp_path.iterdir())) == 1
    with pytest.raises(StorageError, match="choose a folder that can be written"):
        write_json(tmp_path / "a.json" / "b.json", {})
    assert issubclass(StorageError, BudsError) and issubclass(StorageError, OSError)


def test_leftovers_of_a_kill_are_removed_and_nothing_else(tmp_path: Path) -> None:
    names = [
        ".x[1].01234567.part",
        ".x[1].abcdef01.part",
        ".x1.01234567.part",
        ".x[1].y.01234567.part",
        "x[1]",
        ".lock",
    ]
    for name in names:
        (tmp_path / name).mkdir()
        (tmp_path / name / "half").write_text("")
    (tmp_path / ".x[1].99999999.part").write_text("")
    remove_leftovers(tmp_path, "x[1]")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names[2:])
    remove_leftovers(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names[4:])


def test_only_newer_formats_are_refused() -> None:
    for found in (0, 1, 2, None, "3"):
        refuse_newer(Path("a.json"), found, 2, "0.1.0", DatasetError)
    with pytest.raises(
        DatasetError, match=r"a\.json has format 3, .* reads up to 2\. Install lerobot_policy_buds>=0\.9"
    ):
        refuse_newer(Path("a.json"), 3, 2, "0.9", DatasetError)


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


def test_files_replaced_together_are_all_new_or_all_old(tmp_path: Path) -> None:
    old, new = tmp_path / "old.txt", tmp_path / "folder" / "new.txt"
    old.write_text("before")
    with pytest.raises(ValueError), replaced_together() as part_of:
        part_of(old).write_text("after")
        part_of(new).write_text("after")
        raise ValueError
    with pytest.raises(StorageError, match=r"old.txt, .*new.txt could not be written"), replaced_together() as part_of:
        part_of(old).write_text("after")
        part_of(new)  # never written
    assert old.read_text() == "before" and [p.name for p in tmp_path.rglob("*.*")] == ["old.txt"]
    with replaced_together() as part_of:
        part_of(old).write_text("after")
        part_of(new).write_text("after")
        assert old.read_text() == "before"
    assert old.read_text() == new.read_text() == "after" and len(list(tmp_path.rglob("*.*"))) == 2


def test_what_libraries_cannot_write_is_said_once(tmp_path: Path) -> None:
    with pytest.raises(StorageError) as said, storage_errors(tmp_path, "Make room."), storage_errors(tmp_path, "No."):
        raise OSError(28, "No space left on device")
    assert str(said.value) == f"{tmp_path} could not be written ([Errno 28] No space left on device). No."
    with pytest.raises(DatasetError, match="as it was"), storage_errors(tmp_path, "Make room."):
        raise DatasetError("as it was")
