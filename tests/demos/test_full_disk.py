"""A disk that is full is said in one sentence, by whatever writes: LeRobot's encoder, Arrow, or ourselves."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from lerobot_buds.core import StorageError
from lerobot_buds.data.parts import write_part
from lerobot_buds.data.writing import camera_feature, vector_feature
from lerobot_buds.demos import recording
from lerobot_buds.demos.hdf5 import Source
from lerobot_buds.demos.importing import Import, import_demonstrations
from lerobot_buds.demos.recording import Recording, record
from lerobot_buds.envs import EnvSettings

CAMERA = "observation.images.front"
LENGTH = 40


def noise(length: int, size: int = 64) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (length, size, size, 3), dtype=np.uint8)


@pytest.mark.parametrize("limit", [5_000, 60_000])
def test_a_video_that_cannot_be_written(tmp_path: Path, limit: int, largest_file) -> None:
    features = {CAMERA: camera_feature((64, 64, 3), video=True), "action": vector_feature(["x"])}
    columns = {CAMERA: noise(LENGTH), "action": np.zeros((LENGTH, 1), dtype=np.float32)}
    with largest_file(limit), pytest.raises(StorageError, match=r"Make room on its disk.*run the same command again"):
        write_part(tmp_path / "part", "tests/full", 20, features, columns, "lift")
    assert list(tmp_path.iterdir()) == []


def test_an_import_that_does_not_fit_goes_on_once_there_is_room(tmp_path: Path, largest_file) -> None:
    with h5py.File(tmp_path / "demo.hdf5", "w") as file:
        for number in range(2):
            group = file.create_group(f"data/demo_{number}")
            group["actions"] = np.random.default_rng(number).uniform(-1, 1, (LENGTH, 7))
            group["obs/agentview_image"] = noise(LENGTH)
    source = Source(tmp_path / "demo.hdf5", cameras={CAMERA: "agentview_image"}, state=[])
    plan = Import(source, "tests/full", tmp_path / "out", task="lift", fps=20, video=False)
    said = r"out could not be written \(.*What was staged is kept: make room"
    with largest_file(200_000), pytest.raises(StorageError, match=said):
        import_demonstrations(plan, tmp_path / "cache")  # while a part is written
    with largest_file(700_000), pytest.raises(StorageError, match=said):
        import_demonstrations(plan, tmp_path / "cache")  # while parts are joined: two of 0.5 MB
    assert not plan.root.exists()
    assert import_demonstrations(plan, tmp_path / "cache").frames == 2 * LENGTH


def test_a_recording_that_does_not_fit_says_how_it_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    settings = (EnvSettings("multitask_kitchen/task3_variant1", None, 32, "fastest"),)
    wanted = Recording("tests/full", tmp_path / "out", settings, episodes=1, seed=0, workers=1, video=False)
    monkeypatch.setattr(recording, "_written", full)
    with pytest.raises(StorageError, match=r"No space left on device\). Attempts that are whole are kept: make room"):
        record(wanted)
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match=r"could not be written .*see to its permissions"):
        record(replace(wanted, root=tmp_path / "file" / "out"))
