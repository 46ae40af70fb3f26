import json
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lerobot.datasets import LeRobotDataset, add_features

from lerobot_buds.core import DatasetError, StorageError
from lerobot_buds.data import EpisodeArray, cached_frames, frames_key
from lerobot_buds.data import frames as frames_module

pytestmark = pytest.mark.slow

FRONT = "observation.images.front"
WRIST = "observation.images.wrist"


@pytest.mark.parametrize("kind", ["video_root", "image_root"])
def test_frames_equal_those_of_lerobot(kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    root = request.getfixturevalue(kind)
    dataset = LeRobotDataset("test/frames", root=root, video_backend="pyav")
    for camera in (FRONT, WRIST):
        frames = cached_frames(root, camera, tmp_path)
        assert frames.shape == (18, 3, 64, 64) and frames.dtype == np.uint8 and not frames.flags.writeable
        for index in range(18):
            theirs = (dataset[index][camera].numpy() * 255).round().astype(np.uint8)
            np.testing.assert_array_equal(frames[index], theirs)


@pytest.mark.parametrize("kind", ["video_root", "image_root"])
def test_a_copy_with_more_columns_shares_the_cache(kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    root = request.getfixturevalue(kind)
    source = LeRobotDataset("test/frames", root=root)
    spec = {"dtype": "int64", "shape": (1,), "names": None}
    add_features(source, {"skill_id": (np.zeros(18, dtype=np.int64), spec)}, tmp_path / "new", repo_id="test/new")
    assert frames_key(root, FRONT) == frames_key(tmp_path / "new", FRONT)
    assert frames_key(root, FRONT) != frames_key(root, WRIST)


def test_decoded_once_by_threads_that_ask_at_the_same_time(video_root: Path, tmp_path: Path) -> None:
    threads = [threading.Thread(target=cached_frames, args=(video_root, FRONT, tmp_path)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(p.suffix for p in tmp_path.iterdir() if not p.name.startswith(".")) == [".json", ".npy"]
    before = next(tmp_path.glob("*.npy")).stat().st_mtime_ns
    cached_frames(video_root, FRONT, tmp_path)
    assert next(tmp_path.glob("*.npy")).stat().st_mtime_ns == before


def test_video_with_too_few_frames_names_both_counts(
    video_root: Path, copy_of: Callable[[Path], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    decode = frames_module._decode

    def slow(array: EpisodeArray, portion: frames_module.Portion, bar: object) -> None:
        time.sleep(0.5 if portion.episodes == [1] else 0.0)  # still at work when the damage is found
        decode(array, portion, bar)

    monkeypatch.setattr(frames_module, "_decode", slow)
    root = copy_of(video_root)
    longer = tmp_path / "longer"
    shutil.copytree(root, longer)
    _pretend_last_episode_is_longer(longer, 6, 9)
    with pytest.raises(DatasetError, match=r"file-000\.mp4: episode 2 has 9 rows but only 6 video frames"):
        cached_frames(longer, FRONT, tmp_path / "cache")
    # What could be decoded is kept for the next call, and nothing else counts as there.
    (note,) = (tmp_path / "cache").glob("*.json")
    assert json.loads(note.read_text())["episodes"] == [0, 1]


def test_truncated_video_is_refused(video_root: Path, copy_of: Callable[[Path], Path], tmp_path: Path) -> None:
    root = copy_of(video_root)
    video = next((root / "videos" / FRONT).rglob("*.mp4"))
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 2])
    with pytest.raises(DatasetError, match=r"episode \d has \d rows but only \d video frames"):
        cached_frames(root, FRONT, tmp_path / "cache")


def test_missing_camera_names_near_ones(video_root: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"observation\.images\.fron'.*Did you mean 'observation\.images\.front'"):
        cached_frames(video_root, "observation.images.fron", tmp_path)
    with pytest.raises(DatasetError, match="no RGB camera"):
        cached_frames(video_root, "observation.state", tmp_path)


def test_full_disk_is_named_before_decoding(video_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=10, total=10**9))
    with pytest.raises(StorageError, match="needs 221,184 bytes"):
        cached_frames(video_root, FRONT, tmp_path)


def _pretend_last_episode_is_longer(root: Path, was: int, now: int) -> None:
    path = next((root / "meta/episodes").rglob("*.parquet"))
    table = pq.read_table(path)
    for name in ("length", "dataset_to_index"):
        values = table[name].to_pylist()
        values[-1] += now - was
        table = table.set_column(table.column_names.index(name), name, pa.array(values))
    pq.write_table(table, path)
    info = json.loads((root / "meta/info.json").read_text())
    info["total_frames"] += now - was
    (root / "meta/info.json").write_text(json.dumps(info))


def _encode_again(path: Path, pixel_format: str) -> None:
    """Rewrites a video as BT.709 of full range."""
    import av

    with av.open(str(path)) as source:
        stream = source.streams.video[0]
        rate, pictures = stream.average_rate, [frame.to_ndarray(format="rgb24") for frame in source.decode(stream)]
    with av.open(str(path), "w") as target:
        written = target.add_stream("libx264", rate=rate)
        written.height, written.width, written.pix_fmt = *pictures[0].shape[:2], pixel_format
        written.codec_context.color_range, written.codec_context.colorspace = 2, 1  # full, BT.709
        for picture in pictures:
            target.mux(written.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        target.mux(written.encode())


@pytest.mark.parametrize("pixel_format", ["yuv420p", "yuv420p10le"])
@pytest.mark.parametrize("backend", ["torchcodec", "pyav"])
def test_colours_are_those_of_lerobots_decoder_whatever_the_video_is_tagged(
    pixel_format: str, backend: str, video_root: Path, copy_of: Callable[[Path], Path], tmp_path: Path
) -> None:
    """Of full range, BT.709, and 8 or 10 bits: what matters is to see what the batches of a policy show."""
    root = copy_of(video_root)
    _encode_again(next((root / "videos" / FRONT).rglob("*.mp4")), pixel_format)
    dataset = LeRobotDataset("test/frames", root=root, video_backend=backend)
    frames = cached_frames(dataset, FRONT, tmp_path)
    for index in (0, 8, 17):
        theirs = (dataset[index][FRONT].numpy() * 255).round().astype(np.uint8)
        np.testing.assert_array_equal(frames[index], theirs)
