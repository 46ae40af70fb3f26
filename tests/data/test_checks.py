import json
import logging
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

from lerobot_buds.core import DatasetError
from lerobot_buds.data import check_demonstrations, dimension_names

FRONT = "observation.images.front"
WRIST = "observation.images.wrist"


def rewrite(root: Path, column: str, change: Callable[[Any], Any]) -> None:
    """Replaces a column of the only shard by `change` of its rows."""
    shard = next((root / "data").rglob("*.parquet"))
    table = pq.read_table(shard)
    position = table.column_names.index(column)
    values = pa.array(change(table[column].to_pylist()), type=table.schema.field(column).type)
    pq.write_table(table.set_column(position, table.schema.field(column), values), shard)


def put(row: int, value: Any) -> Callable[[Any], Any]:
    def change(rows: Any) -> Any:
        rows[row] = value
        return rows

    return change


def change_info(root: Path, **changes: Any) -> None:
    path = root / "meta/info.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.fixture
def root(image_root: Path, copy_of: Callable[[Path], Path]) -> Path:
    return copy_of(image_root)


def test_sound_demonstrations_pass_without_warning(image_root: Path, video_root: Path, tmp_path: Path) -> None:
    assert check_demonstrations(image_root, cache_dir=tmp_path) == []
    assert check_demonstrations(video_root, [FRONT], cache_dir=tmp_path) == []


def test_all_missing_features_are_named_at_once(root: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError) as caught:
        check_demonstrations(root, ["observation.images.frnt", WRIST], ["observation.state", "actions"], tmp_path)
    message = str(caught.value)
    assert "lacks 2 required" in message
    assert f"Did you mean {FRONT!r}" in message and "Did you mean 'action'" in message


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_values_that_are_not_finite_are_located(root: Path, tmp_path: Path, value: float) -> None:
    rewrite(root, "observation.state", put(9, [0.0, 0.0, value, 0.0]))
    with pytest.raises(DatasetError, match=rf"state' is {value} in episode 1, frame 2, dimension 2 \('eef_x.pos'\)"):
        check_demonstrations(root, cache_dir=tmp_path)


def test_actions_that_are_not_finite_are_located(root: Path, tmp_path: Path) -> None:
    rewrite(root, "action", put(17, [0.0, float("nan")]))
    with pytest.raises(DatasetError, match=r"action' is nan in episode 2, frame 5, dimension 1 \('y'\)"):
        check_demonstrations(root, cache_dir=tmp_path)


def test_constant_dimensions_are_warned_about_by_name(
    root: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rewrite(root, "observation.state", lambda rows: [[*row[:1], 0.5, *row[2:]] for row in rows])
    with caplog.at_level(logging.WARNING):
        (warning,) = check_demonstrations(root, cache_dir=tmp_path)
    assert "dimension 1 ('gripper_left.pos') is constant" in warning and warning in caplog.text


def test_black_camera_is_warned_about_by_name(root: Path, tmp_path: Path) -> None:
    buffer = BytesIO()
    Image.fromarray(np.zeros((64, 64, 3), dtype=np.uint8)).save(buffer, "PNG")
    rewrite(root, WRIST, lambda rows: [{"bytes": buffer.getvalue(), "path": None} for _ in rows])
    (warning,) = check_demonstrations(root, cache_dir=tmp_path)
    assert f"camera {WRIST!r} is black" in warning


@pytest.mark.parametrize(
    ("row", "value", "place"), [(8, 0.25, "episode 1, frame 1"), (3, 0.2, "frame 3"), (5, float("nan"), "frame 5")]
)
def test_timestamps_off_the_clock_are_refused(root: Path, tmp_path: Path, row: int, value: float, place: str) -> None:
    rewrite(root, "timestamp", put(row, value))
    with pytest.raises(DatasetError, match=rf"timestamp of .*{place} is"):
        check_demonstrations(root, cache_dir=tmp_path)


def test_rows_that_do_not_fit_the_episodes_are_refused(root: Path, tmp_path: Path) -> None:
    rewrite(root, "frame_index", put(13, 7))
    with pytest.raises(DatasetError, match="frame_index is 7 in episode 2, frame 1, which should be 1"):
        check_demonstrations(root, cache_dir=tmp_path)


def test_wrong_and_absurd_frame_rates_are_refused(root: Path, tmp_path: Path) -> None:
    change_info(root, fps=20)
    with pytest.raises(DatasetError, match="timestamp of episode 0, frame 1"):
        check_demonstrations(root, cache_dir=tmp_path)
    change_info(root, fps=0)
    with pytest.raises(DatasetError, match="fps=0"):
        check_demonstrations(root, cache_dir=tmp_path)


def test_empty_dataset_is_refused(root: Path, tmp_path: Path) -> None:
    change_info(root, total_frames=0, total_episodes=0)
    for path in [*(root / "data").rglob("*.parquet"), *(root / "meta/episodes").rglob("*.parquet")]:
        path.unlink()
    with pytest.raises(DatasetError, match="holds no frames"):
        check_demonstrations(root, cache_dir=tmp_path)


def test_dimension_names_of_every_spelling() -> None:
    assert dimension_names({"shape": (2,), "names": ["a", "b"]}) == ["a", "b"]
    assert dimension_names({"shape": (2,), "names": {"motors": ["a", "b"]}}) == ["a", "b"]
    assert dimension_names({"shape": (2,), "names": None}) == ["0", "1"]
    assert dimension_names({"shape": (2,), "names": ["a"]}) == ["0", "1"]
