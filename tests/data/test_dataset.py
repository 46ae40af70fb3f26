"""What was chosen of a dataset reaches everything that reads it; cameras, rates and types are those of LeRobot."""

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata

from lerobot_buds.core import DatasetError
from lerobot_buds.data import LocalDataset, cached_frames, check_demonstrations, chosen_cameras, read_table

FRONT = "observation.images.front"


def write(root: Path, fps: float = 10, images: dict[str, tuple[int, ...]] | None = None, **columns: Any) -> Path:
    """Writes two episodes of 4 frames; a column is a dtype, one number a frame."""
    pictures = {FRONT: (32, 32, 3)} if images is None else images
    names = ["height", "width", "channels"]
    features: dict[str, Any] = {n: {"dtype": "image", "shape": shape, "names": names} for n, shape in pictures.items()}
    columns = {"observation.state": "float32", "action": "float32", **columns}
    features |= {name: {"dtype": dtype, "shape": (2,), "names": ["a", "b"]} for name, dtype in columns.items()}
    dataset = LeRobotDataset.create("test/any", fps, features, root=root, use_videos=False)
    for episode in range(2):
        for t in range(4):
            frame: dict[str, Any] = {n: np.full(shape, 60 * t + 9, np.uint8) for n, shape in pictures.items()}
            frame |= {name: np.array([t % 2, (t + episode) % 2]).astype(dtype) for name, dtype in columns.items()}
            dataset.add_frame({**frame, "task": "anything"})
        dataset.save_episode()
    dataset.finalize()
    return root


def test_of_takes_whatever_stands_for_a_dataset(image_root: Path) -> None:
    theirs = LeRobotDataset("test/frames", root=image_root, episodes=[2, 0], video_backend="pyav")
    local = LocalDataset.of(theirs)
    assert (local.root, local.chosen, local.video_backend) == (image_root, (0, 2), "pyav")
    assert LocalDataset.of(local) is local
    whole = LocalDataset.of(LeRobotDatasetMetadata("test/frames", root=image_root))
    assert whole.chosen is None and len(whole.episodes) == 3
    assert LocalDataset.of(str(image_root)).root == LocalDataset.of(image_root).root == image_root


def test_a_subset_reaches_rows_frames_and_checks(image_root: Path, tmp_path: Path) -> None:
    """Episodes of 7, 5 and 6 frames; the last is damaged, and nobody chose it."""
    local = LocalDataset(image_root, chosen=(1,))
    table = read_table(local, ["action"])
    assert table.numbers.tolist() == [1] and table.rows.tolist() == [7, 8, 9, 10, 11]
    assert table.locate(8) == "episode 1, frame 1"
    assert table.present.tolist() == [7 <= row < 12 for row in range(18)]
    some = cached_frames(local, FRONT, tmp_path)
    assert some[7:12].any() and not some[:7].any() and not some[12:].any()
    # What is decoded already is not decoded again, and both are one array.
    everything = cached_frames(image_root, FRONT, tmp_path)
    np.testing.assert_array_equal(everything[7:12], some[7:12])
    assert everything[:7].any() and len(list(tmp_path.glob("*.npy"))) == 1
    assert check_demonstrations(local, cache_dir=tmp_path) == []


@pytest.mark.parametrize("chosen", [(3,), (-1, 0), ()])
def test_episodes_that_do_not_exist_are_refused(image_root: Path, chosen: tuple[int, ...]) -> None:
    with pytest.raises(DatasetError, match="has episodes 0 to 2; chosen were"):
        _ = LocalDataset(image_root, chosen=chosen).episodes


def test_renamed_features_go_by_their_new_names(video_root: Path, tmp_path: Path) -> None:
    renamed = {FRONT: "observation.images.top", "observation.state": "observation.joints"}
    local = LocalDataset(video_root, renamed=renamed)
    assert local.cameras == ["observation.images.top", "observation.images.wrist"]
    np.testing.assert_array_equal(
        cached_frames(local, "observation.images.top", tmp_path), cached_frames(video_root, FRONT, tmp_path)
    )
    assert len(list(tmp_path.glob("*.npy"))) == 1  # the same content, whatever its name
    mine = read_table(local, ["observation.joints"]).columns["observation.joints"]
    np.testing.assert_array_equal(mine, read_table(video_root, ["observation.state"]).columns["observation.state"])
    with pytest.raises(DatasetError, match=r"Did you mean 'observation\.images\.front'"):
        _ = LocalDataset(video_root, renamed={"observation.images.frnt": "x"}).features
    with pytest.raises(DatasetError, match="two features one name"):
        _ = LocalDataset(video_root, renamed={FRONT: "observation.images.wrist"}).features


def test_cameras_are_told_by_type_not_by_name(tmp_path: Path) -> None:
    root = write(tmp_path / "pusht", images={"observation.image": (32, 32, 3), "top": (32, 32, 3)})
    local = LocalDataset(root)
    assert local.cameras == ["observation.image", "top"]
    assert check_demonstrations(local, cache_dir=tmp_path / "cache") == []
    assert len(list((tmp_path / "cache").glob("*.npy"))) == 2


def test_depth_beside_colours_is_refused_and_the_remedy_works(tmp_path: Path) -> None:
    root = write(tmp_path / "depth", images={FRONT: (32, 32, 3), "observation.images.depth": (32, 32, 3)})
    info = json.loads((root / "meta/info.json").read_text())
    info["features"]["observation.images.depth"]["info"] = {"is_depth_map": True}
    (root / "meta/info.json").write_text(json.dumps(info))
    with pytest.raises(
        DatasetError, match=r"'observation\.images\.depth' .*depth.*--representation\.cameras"
    ) as caught:
        check_demonstrations(root, cache_dir=tmp_path)
    advice = str(caught.value).partition("--representation.cameras='[")[2].partition("]'")[0].split(", ")
    assert chosen_cameras(LocalDataset(root).features, advice, "") == [FRONT]
    assert check_demonstrations(root, advice, cache_dir=tmp_path) == []


@pytest.mark.parametrize("dtype", ["bool", "uint8", "uint16", "int64", "float16", "float64"])
def test_numbers_of_any_type(dtype: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    root = write(tmp_path / "typed", action=dtype, mode=dtype)
    table = read_table(LocalDataset(root, chosen=(1,)), ["action"])
    assert table.columns["action"].dtype == np.dtype(dtype)
    assert table.columns["action"][4:].tolist() == [[t % 2, (t + 1) % 2] for t in range(4)]
    with caplog.at_level(logging.WARNING):
        assert check_demonstrations(root, columns=["observation.state", "action", "mode"], cache_dir=tmp_path) == []


@pytest.mark.parametrize("fps", [29.97, 12.5, 30])
def test_rates_are_kept_exactly(fps: float, tmp_path: Path) -> None:
    root = write(tmp_path / "rate", fps=fps)
    assert LocalDataset(root).fps == read_table(root, []).fps == fps
    assert check_demonstrations(root, cache_dir=tmp_path) == []


def test_episodes_so_long_that_float32_holds_their_times_coarsely(image_root: Path, tmp_path: Path) -> None:
    """Past 4,096 s neighbours of float32 are 0.5 ms apart, five times LeRobot's tolerance."""
    from lerobot_buds.data.checks import _check_clock
    from lerobot_buds.data.tables import FrameTable

    total, fps = 100_000, 20.0
    time = (np.arange(total) / fps).astype(np.float32)
    assert np.abs(time - np.arange(total) / fps).max() > 1e-4
    columns = {"timestamp": time, "frame_index": np.arange(total), "episode_index": np.zeros(total, np.int64)}
    places = np.zeros(1, np.int64), np.zeros(1, np.int64), np.array([total])
    _check_clock(FrameTable(tmp_path, fps, *places, columns, np.ones(total, np.bool_)))
    time[70_000] += 0.01
    with pytest.raises(DatasetError, match="timestamp of episode 0, frame 70000"):
        _check_clock(FrameTable(tmp_path, fps, *places, columns, np.ones(total, np.bool_)))


def cells(root: Path, change: Any) -> Path:
    """Rewrites the image cells of a copy's only shard."""
    shard = next((root / "data").rglob("*.parquet"))
    table = pq.read_table(shard)
    rows = [change(i, cell) for i, cell in enumerate(table[FRONT].to_pylist())]
    place = table.column_names.index(FRONT)
    pq.write_table(
        table.set_column(place, table.schema.field(FRONT), pa.array(rows, table.schema.field(FRONT).type)), shard
    )
    return root


def test_cells_with_a_path_and_no_bytes_are_read_as_lerobot_reads_them(tmp_path: Path) -> None:
    root = write(tmp_path / "paths")
    before = cached_frames(root, FRONT, tmp_path / "before").copy()

    def outside(row: int, cell: Any) -> Any:
        (tmp_path / f"{row}.png").write_bytes(cell["bytes"])
        return {"bytes": None, "path": str(tmp_path / f"{row}.png")}

    cells(root, outside)
    np.testing.assert_array_equal(cached_frames(root, FRONT, tmp_path / "after"), before)
    (tmp_path / "3.png").unlink()
    with pytest.raises(DatasetError, match=r"at index 3 lies in .*3\.png, which is not there"):
        cached_frames(root, FRONT, tmp_path / "again")


def test_empty_cells_and_other_modes_name_their_frame(tmp_path: Path) -> None:
    root = write(tmp_path / "cells")
    cells(root, lambda row, cell: None if row == 5 else cell)
    with pytest.raises(DatasetError, match="at index 5 is empty"):
        cached_frames(root, FRONT, tmp_path / "a")
    from io import BytesIO

    from PIL import Image

    rgba = BytesIO()
    Image.new("RGBA", (32, 32)).save(rgba, "PNG")
    cells(root, lambda row, cell: {"bytes": rgba.getvalue(), "path": None} if row == 5 else cell)
    with pytest.raises(DatasetError, match=r"at index 5 has shape \(32, 32, 4\); info.json says \(32, 32, 3\)"):
        cached_frames(root, FRONT, tmp_path / "b")
