"""The frame store: its bound, what makes room, and what a kill leaves."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lerobot_buds.core import ConfigError, DatasetError, StorageError
from lerobot_buds.data import (
    EpisodeArray,
    FrameStore,
    LocalDataset,
    cached_frames,
    only_writer,
    scale_images,
    used_size,
)
from lerobot_buds.data import frames as frames_module

FRONT, WRIST = "observation.images.front", "observation.images.wrist"
BLOCK = 64 * 1024


def filled(folder: Path, name: str, used_at: float) -> EpisodeArray:
    """An array of 64 KiB, last used at a time."""
    array = EpisodeArray(folder / f"{name}.npy", (BLOCK,), np.uint8, name)
    FrameStore(folder, 10**9).reserve(array.path, BLOCK)
    array.create()
    array.write(0, np.ones(BLOCK, np.uint8))
    array.finish([0])
    os.utime(array.path, (used_at, used_at))
    return array


@pytest.mark.parametrize(
    ("text", "limit"), [("200GB", 200 * 10**9), ("1.5 TB", 1_500 * 10**9), ("500mb", 500 * 10**6), ("4096", 4096)]
)
def test_the_bound_is_a_size(text: str, limit: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BUDS_STORE_LIMIT", text)
    assert FrameStore.open(tmp_path).limit_bytes == limit


def test_the_bound_is_a_share_of_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    total = shutil.disk_usage(tmp_path).total
    assert FrameStore.open(tmp_path / "not/there/yet").limit_bytes == int(0.2 * total)
    monkeypatch.setenv("BUDS_STORE_LIMIT", "50%")
    assert FrameStore.open(tmp_path).limit_bytes == int(0.5 * total)


@pytest.mark.parametrize("text", ["much", "0", "-5GB", "10 elephants", "%"])
def test_bounds_that_say_nothing_are_refused(text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BUDS_STORE_LIMIT", text)
    with pytest.raises(ConfigError, match="BUDS_STORE_LIMIT"):
        FrameStore.open(tmp_path)


def test_the_least_recently_used_makes_room(tmp_path: Path) -> None:
    old, older, used = (filled(tmp_path, name, at) for name, at in (("old", 200), ("older", 100), ("used", 150)))
    used.read()  # now it is the latest
    store = FrameStore(tmp_path, int(3.5 * BLOCK))
    assert store.used_bytes() >= 3 * BLOCK
    kept = old.read()
    store.reserve(tmp_path / "new.npy", BLOCK)
    assert not older.path.exists() and used.finished() == {0}
    store.reserve(tmp_path / "new.npy", 2 * BLOCK)
    assert kept.sum() == BLOCK  # who has it open keeps it
    with pytest.raises(StorageError, match=r"may hold 229,376.*Raise BUDS_STORE_LIMIT"):
        store.reserve(tmp_path / "new.npy", 4 * BLOCK)
    filled(tmp_path, "last", 300)
    assert store.clear() >= BLOCK and store.used_bytes() == 0 and store.arrays() == []


def test_frames_are_kept_at_the_size_that_is_used(video_root: Path, tmp_path: Path) -> None:
    small = cached_frames(video_root, FRONT, tmp_path, (16, 16))
    large = cached_frames(video_root, FRONT, tmp_path)
    assert small.shape == (18, 3, 16, 16) and large.shape == (18, 3, 64, 64)
    import torch

    np.testing.assert_array_equal(scale_images(torch.from_numpy(large[:]), (16, 16)).numpy(), small)
    sizes = sorted(path.stat().st_size for path in tmp_path.glob("*.npy"))
    assert sizes[0] * 15 < sizes[1] < sizes[0] * 17


@pytest.mark.parametrize(
    ("stored", "side", "used"),
    [
        ((480, 640), 128, (128, 128)),
        ((96, 96), 128, (96, 96)),
        ((128, 128), 128, (128, 128)),
        ((48, 64), None, (48, 64)),
    ],
)
def test_nothing_is_enlarged(stored: tuple[int, int], side: int | None, used: tuple[int, int]) -> None:
    assert used_size(stored, side) == used


@pytest.mark.parametrize("kind", ["video_root", "image_root"])
def test_a_killed_decoding_goes_on_where_it_was(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = request.getfixturevalue(kind)
    whole = cached_frames(root, WRIST, tmp_path / "whole")
    # A kill in the middle: one episode is there, and the bytes of another half.
    cached_frames(LocalDataset(root, chosen=(1,)), WRIST, tmp_path / "cut")
    (path,) = (tmp_path / "cut").glob("*.npy")
    with path.open("r+b") as file:
        file.seek(-5000, os.SEEK_END)
        file.write(b"x" * 4000)
    decoded: list[int] = []
    decode = frames_module._decode

    def counting(array: EpisodeArray, portion: frames_module.Portion, bar: object) -> None:
        decoded.extend(int(record["episode_index"]) for record in portion.records)
        decode(array, portion, bar)

    monkeypatch.setattr(frames_module, "_decode", counting)
    np.testing.assert_array_equal(cached_frames(root, WRIST, tmp_path / "cut"), whole)
    assert sorted(decoded) == [0, 2]


def test_an_array_without_its_note_counts_as_empty(image_root: Path, tmp_path: Path) -> None:
    first = cached_frames(image_root, FRONT, tmp_path).copy()
    (note,) = tmp_path.glob("*.json")
    note.write_text("{half a no")
    np.testing.assert_array_equal(cached_frames(image_root, FRONT, tmp_path), first)


def test_damage_in_one_episode_does_not_hide_the_others(
    video_root: Path, copy_of: Callable[[Path], Path], tmp_path: Path
) -> None:
    root = copy_of(video_root)
    video = next((root / "videos" / FRONT).rglob("*.mp4"))
    video.write_bytes(b"")
    with pytest.raises(DatasetError, match=r"file-000\.mp4: episode \d has \d rows but only 0 video frames"):
        cached_frames(root, FRONT, tmp_path)
    assert not any(EpisodeArray(p, (18, 3, 64, 64), np.uint8, "").finished() for p in tmp_path.glob("*.npy"))


def test_a_store_that_is_removed_meanwhile_is_filled_again(
    video_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, store, removals = cached_frames(video_root, WRIST, tmp_path / "whole"), tmp_path / "store", [0, 0]
    decode, read = frames_module._decode, EpisodeArray.read

    def decoding(array: EpisodeArray, portion: frames_module.Portion, bar: object) -> None:
        removals[0] += 1
        if removals[0] == 1:
            shutil.rmtree(store)
        decode(array, portion, bar)

    def reading(array: EpisodeArray) -> np.ndarray:
        removals[1] += 1
        if removals[1] == 1:
            shutil.rmtree(store)
        return read(array)

    monkeypatch.setattr(frames_module, "_decode", decoding)
    monkeypatch.setattr(EpisodeArray, "read", reading)
    np.testing.assert_array_equal(cached_frames(video_root, WRIST, store), whole)
    assert removals[1] == 2
    monkeypatch.setattr(EpisodeArray, "read", lambda array: shutil.rmtree(store) or read(array))
    with pytest.raises(StorageError, match=r"was removed 5 times .* Raise BUDS_STORE_LIMIT"):
        cached_frames(video_root, WRIST, store)


def test_what_another_is_filling_makes_no_room(tmp_path: Path) -> None:
    oldest, other = filled(tmp_path, "oldest", 100), filled(tmp_path, "other", 200)
    with only_writer(oldest.path):
        FrameStore(tmp_path, int(2.5 * BLOCK)).reserve(tmp_path / "new.npy", BLOCK)
    assert oldest.finished() == {0} and not other.path.exists()
