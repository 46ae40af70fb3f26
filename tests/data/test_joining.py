"""What is joined of parts is the dataset that LeRobot's own writer makes of the same episodes, in the same files."""

import io
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from lerobot.datasets import LeRobotDataset
from numpy.typing import NDArray
from PIL import Image

from lerobot_buds.core import DatasetError, read_json, write_json
from lerobot_buds.data import cached_frames, check_demonstrations
from lerobot_buds.data.joining import join_parts
from lerobot_buds.data.parts import write_part
from lerobot_buds.data.writing import camera_feature, create_dataset, vector_feature, write_episode

pytestmark = pytest.mark.slow

CAMERAS = ("observation.images.front", "observation.images.hand")
LENGTHS, TASKS = (7, 12, 5, 9), ("lift", "stack", "lift", "lift")


@dataclass(frozen=True)
class Episodes:
    """Four episodes of two tasks, and where they are written."""

    folder: Path
    video: bool

    @property
    def features(self) -> dict[str, dict[str, Any]]:
        return {
            **{camera: camera_feature((48, 32, 3), self.video) for camera in CAMERAS},
            "observation.state": vector_feature(["x", "y"]),
            "action": vector_feature(["gripper"]),
            "true_stage": {"dtype": "int64", "shape": (1,), "names": None},
        }

    def columns(self, number: int) -> dict[str, NDArray[Any]]:
        rng, length = np.random.default_rng(number), LENGTHS[number]
        return {
            **{camera: rng.integers(0, 256, (length, 48, 32, 3), np.uint8) for camera in CAMERAS},
            "observation.state": rng.normal(size=(length, 2)).astype(np.float32),
            "action": rng.normal(size=(length, 1)).astype(np.float32),
            "true_stage": np.arange(length)[:, None] // 3,
        }

    def written(self) -> Path:
        """Through LeRobot's own writer, one after the other."""
        dataset = create_dataset("test/x", self.folder / "written", 20, self.features, "panda")
        for number, task in enumerate(TASKS):
            write_episode(dataset, self.columns(number), task)
        dataset.finalize()
        return self.folder / "written"

    def parts(self) -> list[Path]:
        parts = [self.folder / f"part_{number}" for number in range(len(TASKS))]
        for number, part in enumerate(parts):
            write_part(part, "test/x", 20, self.features, self.columns(number), TASKS[number], "panda")
        return parts

    def joined(self, parts: list[Path]) -> Path:
        assert join_parts(iter(parts), "test/x", self.folder / "joined") == list(LENGTHS)
        return self.folder / "joined"


@pytest.fixture(params=[False, True], ids=["images", "video"])
def episodes(request: pytest.FixtureRequest, tmp_path: Path) -> Episodes:
    return Episodes(tmp_path, request.param)


def names(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()}


def rows(path: Path) -> tuple[dict[str, list[Any]], list[int]]:
    """Content of a parquet file, images decoded, and the sizes of its row groups."""
    file = pq.ParquetFile(path)
    content = file.read().to_pydict()
    for camera in set(content) & set(CAMERAS):
        content[camera] = [
            (image["path"], np.array(Image.open(io.BytesIO(image["bytes"]))).tolist()) for image in content[camera]
        ]
    return content, [file.metadata.row_group(group).num_rows for group in range(file.num_row_groups)]


def test_what_is_joined_is_what_lerobots_writer_makes(episodes: Episodes) -> None:
    written, joined = episodes.written(), episodes.joined(episodes.parts())
    assert names(joined) == names(written)
    assert read_json(joined / "meta/info.json") == read_json(written / "meta/info.json")
    for name in (name for name in names(written) if name.endswith(".parquet")):
        assert rows(joined / name) == rows(written / name), name
    ours, theirs = read_json(joined / "meta/stats.json"), read_json(written / "meta/stats.json")
    assert ours.keys() == theirs.keys()
    for feature, stats in theirs.items():
        for statistic, value in stats.items():  # LeRobot sums some of them up in single precision
            np.testing.assert_allclose(ours[feature][statistic], value, rtol=1e-6, atol=1e-7)
    for camera in CAMERAS:
        views = [cached_frames(root, camera, episodes.folder / "cache") for root in (joined, written)]
        np.testing.assert_array_equal(*views)


def test_a_full_file_is_followed_by_the_next(episodes: Episodes) -> None:
    parts = episodes.parts()
    for part in parts:  # no file takes a second episode, no folder a third file
        info = read_json(part / "meta/info.json")
        sizes = {"chunks_size": 2, "data_files_size_in_mb": 1e-6, "video_files_size_in_mb": 1e-6}
        write_json(part / "meta/info.json", {**info, **sizes})
    joined = episodes.joined(parts)
    places = [f"chunk-{folder:03d}/file-{file:03d}" for folder in range(2) for file in range(2)]
    expected = {f"data/{place}.parquet" for place in places}
    if episodes.video:
        expected |= {f"videos/{camera}/{place}.mp4" for camera in CAMERAS for place in places}
    assert {name for name in names(joined) if not name.startswith("meta/")} == expected
    check_demonstrations(joined, list(CAMERAS), ["observation.state", "action"], episodes.folder / "cache", 32)
    split = LeRobotDataset("test/x", root=joined)
    again = replace(episodes, folder=episodes.folder / "again")
    whole = LeRobotDataset("test/x", root=again.joined(again.parts()))
    for index in (0, 6, 7, sum(LENGTHS) - 1):
        one, other = split[index], whole[index]
        assert one.keys() == other.keys() and one.pop("task") == other.pop("task")
        assert all((one[name] == other[name]).all() for name in one)


def test_parts_are_joined_as_they_come(episodes: Episodes) -> None:
    parts, seen = episodes.parts(), []

    def coming():
        for part in parts:
            info = episodes.folder / "joined/meta/info.json"
            seen.append(read_json(info)["total_episodes"] if info.exists() else 0)
            yield part

    join_parts(coming(), "test/x", episodes.folder / "joined")
    assert seen == [0, 1, 2, 3]


def test_a_damaged_part_is_named(episodes: Episodes) -> None:
    parts = episodes.parts()
    (parts[1] / "meta/info.json").unlink()
    with pytest.raises(DatasetError, match="part_1 is no LeRobotDataset"):
        join_parts(parts, "test/x", episodes.folder / "joined")


def test_a_part_that_cannot_be_written_leaves_nothing(episodes: Episodes) -> None:
    columns = episodes.columns(0)
    columns[CAMERAS[1]] = columns[CAMERAS[1]][:, :40]
    with pytest.raises(ValueError, match=r"observation\.images\.hand.*shape"):
        write_part(episodes.folder / "x", "test/x", 20, episodes.features, columns, "lift")
    assert list(episodes.folder.iterdir()) == []
