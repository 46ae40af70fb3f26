"""What cannot be segmented is refused with what, where and a remedy; nothing is written, the source is not touched."""

import json
import re
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lerobot_buds.core import ACTION, STATE, DatasetError

FRONT = "observation.images.front"


@pytest.fixture(scope="module")
def images(make_dataset, tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("faults") / "images", lengths=(15, 12, 13))


@pytest.fixture(scope="module")
def videos(make_dataset, tmp_path_factory):
    """Every episode has a video file of its own."""
    return make_dataset(
        tmp_path_factory.mktemp("faults") / "videos", lengths=(15, 12, 13), video=True, video_files_size_in_mb=0.001
    )


def data_of(root: Path) -> Path:
    return next((root / "data").rglob("*.parquet"))


def put(column: str, row: int, value):
    """Makes a damage: one value of a column of the only shard."""

    def damage(root: Path) -> None:
        table = pq.read_table(data_of(root))
        values = table[column].to_pylist()
        values[row] = value
        field = table.schema.field(column)
        changed = table.set_column(table.column_names.index(column), field, pa.array(values, type=field.type))
        pq.write_table(changed, data_of(root))

    return damage


def cut(kind: str, keep: float):
    """Makes a damage: the second file of a kind, or the only one, is cut off."""

    def damage(root: Path) -> None:
        path = sorted((root / kind).rglob("*.*"))[-2:][0]
        path.write_bytes(path.read_bytes()[: int(keep * path.stat().st_size)])

    return damage


def info(change):
    """Makes a damage: changed metadata."""

    def damage(root: Path) -> None:
        path = root / "meta/info.json"
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))

    return damage


def lose_second_video(root: Path) -> None:
    sorted((root / "videos").rglob("*.mp4"))[1].unlink()


def lose_an_episode_of_frames(root: Path) -> None:
    path = next((root / "meta/episodes").rglob("*.parquet"))
    table = pq.read_table(path)
    rows = table.to_pylist()
    rows[1] |= {"length": 0, "dataset_to_index": 15}
    rows[2] |= {"length": 25, "dataset_from_index": 15}
    pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), path)


def lose_two_rows(root: Path) -> None:
    table = pq.read_table(data_of(root))
    pq.write_table(table.slice(0, len(table) - 2), data_of(root))


def shorter(content) -> None:
    content["features"][FRONT]["shape"] = [48, 32, 3]


NAN, INF = float("nan"), float("inf")
DAMAGES = {
    "parquet cut off": (cut("data", 0.5), r"file-000.parquet cannot be read .*episodes 0 to 2.*fetch it again"),
    "parquet without footer": (cut("data", 0.999), r"file-000.parquet cannot be read .*episodes 0 to 2.*fetch"),
    "parquet empty": (cut("data", 0.0), r"file-000.parquet cannot be read .*episodes 0 to 2.*fetch it again"),
    "episode records cut off": (cut("meta/episodes", 0.5), r"file-000.parquet is damaged.*download or record"),
    "episode without frames": (lose_an_episode_of_frames, r"episode 1 has no frames, nor have 0 more.*record it again"),
    "rows lost": (lose_two_rows, r"2 of 40 rows are not on this machine, the first is episode 2, frame 11\. Download"),
    "state not a number": (
        put(STATE, 17, [0.0, NAN, 0.0, 0.0]),
        r"state' is nan in episode 1, frame 2, dimension 1 \('gripper.pos'\).*Repair",
    ),
    "action infinite": (put(ACTION, 39, [0.0, INF]), r"action' is inf in episode 2, frame 12, dimension 1 \('y'\)"),
    "time repeated": (put("timestamp", 3, 0.1), r"timestamp of episode 0, frame 3 is 0.1.* is 0.15.*correct fps"),
    "time goes back": (put("timestamp", 20, 0.0), r"timestamp of episode 1, frame 5 is 0.0.* is 0.25"),
    "another frame rate": (info(lambda c: c.update(fps=30)), r"timestamp of episode 0, frame 1 is 0.05.*\(fps 30\)"),
    "no frame rate": (info(lambda c: c.update(fps=0)), r"info.json: fps=0 is outside \(0.1, 1000.0\); correct it"),
    "no key": (info(lambda c: c.pop("features")), r"info.json is damaged \(no \['features'\]\)"),
    "rows of another episode": (put("episode_index", 2, 1), r"episode_index is 1 in episode 0, frame 2, which should"),
    "image cut off": (put(FRONT, 16, {"bytes": b"\x89PNG\r\n", "path": None}), r"front' at index 16 is damaged"),
    "frames of another size": (info(shorter), r"at index 0 has shape \(32, 32, 3\); .*says \(48, 32, 3\)"),
    "channels in another place": (
        info(lambda c: c["features"][FRONT].update(names=["channels", "height", "width"])),
        r"front' \(shape \(32, 32, 3\), names \['channels'.*no RGB images.*"
        r"Name the cameras to use, --representation.cameras='\[\]', or correct",
    ),
    "an old format": (info(lambda c: c.update(codebase_version="v2.1")), r"dataset format v2.1 is not v3; convert it"),
}


def refusal(original, damage, refused, tmp_path) -> str:
    source = Path(shutil.copytree(original, tmp_path / "source"))
    damage(source)
    return refused(source, DatasetError)


@pytest.mark.parametrize("name", DAMAGES)
def test_damaged_datasets_are_refused(name, images, refused, tmp_path):
    damage, message = DAMAGES[name]
    assert re.search(message, refusal(images, damage, refused, tmp_path), re.DOTALL)


VIDEO_DAMAGES = {
    "cut off": (cut("videos", 0.5), r"file-001.mp4: episode 1 has 12 rows but only \d video frames.*fetch it again"),
    "without its index": (cut("videos", 0.95), r"file-001.mp4: episode 1 has 12 rows but only 0 video frames.*fetch"),
    "empty": (cut("videos", 0.0), r"file-001.mp4: episode 1 has 12 rows but only 0 video frames"),
    "lost": (lose_second_video, r"file-001.mp4 is not there: episode 1 has 12 rows but 0 frames of .*Download the"),
}


def test_a_lost_video_of_a_camera_that_is_not_used_is_refused(videos, refused, tmp_path):
    """LeRobot would go to the Hub for it, and write into the source."""
    source = Path(shutil.copytree(videos, tmp_path / "source"))
    lose_second_video(source)
    assert "is not there: episode 1" in refused(source, DatasetError, representation={"cameras": []})


@pytest.mark.parametrize("name", VIDEO_DAMAGES)
def test_damaged_videos_are_refused_before_anything_is_trained(name, videos, refused, tmp_path):
    damage, message = VIDEO_DAMAGES[name]
    assert re.search(message, refusal(videos, damage, refused, tmp_path), re.DOTALL)


def test_all_that_is_missing_is_said_at_once(images, refused, tmp_path):
    source = Path(shutil.copytree(images, tmp_path / "source"))
    info(lambda content: [content["features"].pop(name) for name in (STATE, ACTION)])(source)
    message = refused(source, DatasetError, representation={"cameras": ["observation.images.frnt"]})
    assert "lacks 3 required feature(s); name others in the settings, or record them" in message
    assert f"'observation.images.frnt': Did you mean {FRONT!r}?" in message
    assert f"{STATE!r}: " in message and f"{ACTION!r}: " in message
