"""What a pass cannot do is refused before the representation is trained; two passes never mix; a full disk is said."""

import resource
import shutil
from collections import namedtuple
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_buds.cli.segment import segment
from lerobot_buds.core import ACTION, STATE, BudsError, ConfigError, DatasetError, SegmentationError, StorageError
from lerobot_buds.data import only_writer
from lerobot_buds.data.writing import camera_feature, create_dataset, vector_feature, write_episode
from lerobot_buds.segmentation import load_labels

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def source(make_dataset, tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("refusals") / "source")


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"discovery": {"n_skills": 900}}, SegmentationError, "n_skills = 900 .*only 12 temporal segments. Lower n_sk"),
        ({"discovery": {"max_skills": 0}}, ConfigError, "max_skills = 0 cannot work"),
        ({"discovery": {"feature": "meen"}}, ConfigError, "Did you mean 'mean'"),
        ({"subgoal_horizon_s": -1.0}, ConfigError, "subgoal_horizon_s=-1.0 must be positive"),
        (
            {"representation": {"image_size": 64}},
            DatasetError,
            "32 x 32 pixels, image_size asks for 64. Set image_size",
        ),
    ],
)
def test_settings_that_cannot_work(source, refused, changes, error, message):
    with pytest.raises(error, match=message):
        raise error(refused(source, error, **changes))


@pytest.mark.parametrize("place", ["output_root", "work_dir"])
def test_places_inside_the_source(source, refused, place):
    with pytest.raises(BudsError, match=r"lies in .*/source, which is only read; choose"):
        raise BudsError(refused(source, BudsError, **{place: str(source / "meta/inside")}))


def test_a_target_that_exists_and_a_source_with_labels(source, settings, refused, tmp_path):
    segment(settings(source, tmp_path / "done"))
    done = tmp_path / "done/skills"
    assert "exists already; remove it, or choose another" in refused(source, SegmentationError, output_root=str(done))
    assert "already has the columns ['skill_id', 'subgoal_index']" in refused(done, SegmentationError)


@pytest.mark.parametrize("folder", ["/proc/buds", "a file"])
def test_places_that_cannot_be_written(source, refused, tmp_path, folder):
    """Nobody creates a folder in /proc, not even root."""
    (tmp_path / "a file").write_text("")
    target, work = tmp_path / folder / "skills", tmp_path / folder / "work"
    message = refused(source, DatasetError, output_root=str(target))
    assert f"{target} could not be written" in message and "It needs about" in message and "untouched" in message
    assert "choose a folder that can be" in refused(source, StorageError, work_dir=str(work))


def test_a_disk_too_small_for_the_copy(source, refused, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10, 9, 1))
    assert "bytes, but its disk has only 1 free" in refused(source, DatasetError)


def test_a_disk_that_fills_up_at_any_stage(make_dataset, settings, hashes, largest_file, tmp_path):
    """Frames take 42 kB, the representation's weights under way 2.2 MB and at the end 750 kB, the picture 30 kB."""
    source = make_dataset(tmp_path / "source", lengths=(31, 25))  # its frames are in no cache yet
    before, failed = hashes(source), []
    for size in (30_000, 1_000_000, None):
        try:
            with largest_file(size or resource.RLIM_INFINITY):
                segment(settings(source, tmp_path / "run"))
        except StorageError as error:
            failed.append(str(error))
            assert "File too large" in failed[-1] and "Make room on its disk" in failed[-1]
            assert not [path for path in tmp_path.rglob("*.part") if "home" not in path.parts]
            assert not (tmp_path / "run/skills").exists() and hashes(source) == before
    assert [Path(message.split()[0]).suffix for message in failed] == [".npy", ".safetensors"]

    shutil.rmtree(tmp_path / "run/skills")
    (tmp_path / "run/work/timeline.png").unlink()
    with pytest.raises(StorageError, match=r"reconstructions\.png could not be written"), largest_file(10_000):
        segment(settings(source, tmp_path / "run"))
    segment(settings(source, tmp_path / "run"))
    segment(settings(source, tmp_path / "unbroken"))
    assert hashes(tmp_path / "run") == hashes(tmp_path / "unbroken")


@pytest.mark.parametrize("place", ["skills", "work"])
def test_a_second_pass_over_the_same_place_is_refused(source, refused, tmp_path, place):
    with only_writer(tmp_path / place):
        assert f"Another process is writing {tmp_path / place}; wait for it" in refused(source, DatasetError)


def test_of_two_passes_at_once_one_ends_whole(source, settings, hashes, tmp_path):
    def run(number: int) -> bool:
        try:
            segment(settings(source, tmp_path, representation={"seed": number}))
        except (DatasetError, SegmentationError):
            return False
        return True

    with ThreadPoolExecutor(2) as pool:
        finished = list(pool.map(run, (0, 1)))
    assert sorted(finished) == [False, True]
    record, *_ = load_labels(tmp_path / "skills")
    assert record.seeds["representation"] == finished.index(True)
    segment(settings(source, tmp_path / "alone", representation={"seed": finished.index(True)}))
    for name in ("skills", "work"):
        assert hashes(tmp_path / name) == hashes(tmp_path / "alone" / name)


@pytest.mark.parametrize("fps", [12.5, 29.97])
def test_videos_are_not_cut_at_rates_that_are_not_whole(settings, refused, tmp_path, fps):
    """LeRobot would; the frames that it keeps have the times of 12 and 29 frames a second, and cannot be loaded."""
    vectors = {STATE: vector_feature(["x"]), ACTION: vector_feature(["dx"])}
    made = create_dataset(
        "tests/cut", tmp_path / "source", fps, {"observation.image": camera_feature((32, 32, 3), True)} | vectors
    )
    noise = np.random.default_rng(0)
    for length in (40, 35, 30):
        columns = {name: noise.normal(size=(length, 1)).astype(np.float32) for name in vectors}
        write_episode(
            made, columns | {"observation.image": noise.integers(0, 255, (length, 32, 32, 3), np.uint8)}, "go"
        )
    made.finalize()
    message = refused(tmp_path / "source", SegmentationError, episodes=[0, 2])
    assert f"other episodes at {fps:g} frames per second" in message and "--dataset.episodes='[0, 2]'" in message
    segment(settings(tmp_path / "source", tmp_path / "whole", episodes=[0, 1, 2]))
    advised = LeRobotDataset("tests/skills", root=tmp_path / "whole/skills", episodes=[0, 2])
    assert len(advised) == 70 and advised[69]["observation.image"].shape == (3, 32, 32)
