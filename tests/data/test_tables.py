from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_buds.core import DatasetError
from lerobot_buds.data import LocalDataset, read_table


def test_columns_equal_those_of_lerobot(image_root: Path) -> None:
    table = read_table(image_root, ["observation.state", "action", "true_stage", "timestamp"])
    dataset = LeRobotDataset("test/frames", root=image_root)
    assert table.fps == 10 and table.n_episodes == 3 and table.present.all()
    assert table.starts.tolist() == [0, 7, 12] and table.ends.tolist() == [7, 12, 18]
    assert table.columns["true_stage"].shape == (18,) and table.columns["true_stage"].dtype == np.int64
    assert table.columns["timestamp"].shape == (18,)
    for index in range(18):
        for name in ("observation.state", "action"):
            np.testing.assert_array_equal(table.columns[name][index], dataset[index][name].numpy())


def test_locate_names_episode_and_frame(image_root: Path) -> None:
    table = read_table(image_root, [])
    assert table.locate(0) == "episode 0, frame 0"
    assert table.locate(7) == "episode 1, frame 0"
    assert table.locate(17) == "episode 2, frame 5"


def test_all_missing_columns_are_named_at_once(image_root: Path) -> None:
    with pytest.raises(DatasetError) as caught:
        read_table(image_root, ["observation.stat", "acton", "action"])
    message = str(caught.value)
    assert "2 required" in message and "Did you mean 'observation.state'" in message
    assert "'acton'" in message and "Did you mean 'action'" in message


def test_truncated_parquet_names_file_and_episodes(image_root: Path, copy_of: Callable[[Path], Path]) -> None:
    root = copy_of(image_root)
    shard = next((root / "data").rglob("*.parquet"))
    shard.write_bytes(shard.read_bytes()[: shard.stat().st_size // 2])
    with pytest.raises(DatasetError, match=r"file-000\.parquet cannot be read.*episodes 0 to 2"):
        read_table(root, ["action"])


def test_absent_shards_leave_marked_rows(image_root: Path, copy_of: Callable[[Path], Path]) -> None:
    root = copy_of(image_root)
    shard = next((root / "data").rglob("*.parquet"))
    pq.write_table(pq.read_table(shard).slice(7, 5), shard)
    table = read_table(root, ["action", "true_stage"])
    assert table.present.tolist() == [False] * 7 + [True] * 5 + [False] * 6
    assert np.isnan(table.columns["action"][0]).all() and table.columns["true_stage"][0] == -1
    assert np.isfinite(table.columns["action"][7:12]).all()


def test_repeated_rows_are_refused(image_root: Path, copy_of: Callable[[Path], Path]) -> None:
    root = copy_of(image_root)
    shard = next((root / "data").rglob("*.parquet"))
    whole = pq.read_table(shard)
    pq.write_table(pa.concat_tables([whole, whole]), shard)
    with pytest.raises(DatasetError, match="repeat rows"):
        read_table(root, ["action"])


def test_what_is_no_dataset_is_said(tmp_path: Path, image_root: Path, copy_of: Callable[[Path], Path]) -> None:
    with pytest.raises(DatasetError, match="no LeRobotDataset"):
        read_table(tmp_path / "nothing", [])
    root = copy_of(image_root)
    (root / "meta/info.json").write_text("{")
    with pytest.raises(DatasetError, match="damaged"):
        read_table(root, [])
    with pytest.raises(DatasetError, match="no numeric vector"):
        read_table(image_root, ["observation.images.front"])


def test_unfinished_recording_is_refused(image_root: Path, copy_of: Callable[[Path], Path]) -> None:
    root = copy_of(image_root)
    next((root / "meta/episodes").rglob("*.parquet")).unlink()
    with pytest.raises(DatasetError, match="hold 0 frames"):
        LocalDataset(root).episodes  # noqa: B018
