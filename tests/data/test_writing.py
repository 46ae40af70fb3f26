"""One writer at a time, and files of a cache that are made once."""

from pathlib import Path
from threading import Event, Thread

import pytest

from lerobot_buds.core import ConfigError, DatasetError, StorageError
from lerobot_buds.data import make_once, only_writer
from lerobot_buds.data.writing import camera_feature, create_dataset


def test_a_second_writer_is_refused_and_the_next_is_not(tmp_path: Path) -> None:
    target = tmp_path / "new" / "x"
    with only_writer(target), only_writer(tmp_path / "new" / "y"):
        refused = pytest.raises(DatasetError, match=r"Another process is writing .*/new/x; wait for it, or end it")
        with refused, only_writer(target):
            pass
    with only_writer(target):
        pass


def test_a_writer_that_failed_keeps_nobody_away(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), only_writer(tmp_path / "x"):
        raise RuntimeError
    with only_writer(tmp_path / "x"):
        pass


def test_a_place_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(StorageError, match=r"file/x cannot be written .*choose a folder"),
        only_writer(tmp_path / "file/x"),
    ):
        pass


def test_a_file_is_made_once_without_what_a_kill_left(tmp_path: Path) -> None:
    path, begun, go_on, made = tmp_path / "cache" / "a.npy", Event(), Event(), []
    path.parent.mkdir()
    (path.parent / ".a.npy.01234567.part").write_text("half")

    def write(part: Path) -> None:
        made.append(part)
        begun.set()
        assert go_on.wait(20)
        part.write_text("whole")

    threads = [Thread(target=make_once, args=(path, write)) for _ in range(2)]
    threads[0].start()
    assert begun.wait(20)
    threads[1].start()  # waits for the first
    go_on.set()
    for thread in threads:
        thread.join()
    assert path.read_text() == "whole" and len(made) == 1
    assert [p.name for p in path.parent.iterdir() if p.suffix != ".lock"] == ["a.npy"]


@pytest.mark.parametrize("shape", [(31, 64, 3), (64, 16, 3)])
def test_no_dataset_of_video_that_ends_the_process_is_created(tmp_path: Path, shape: tuple[int, ...]) -> None:
    features = {"observation.images.hand": camera_feature(shape, video=True)}
    with pytest.raises(ConfigError, match=f"'observation.images.hand' is {shape[1]} x {shape[0]} pixels"):
        create_dataset("test/x", tmp_path / "x", 20, features)
    assert not (tmp_path / "x").exists()
    create_dataset("test/x", tmp_path / "x", 20, {"observation.images.hand": camera_feature(shape, video=False)})
