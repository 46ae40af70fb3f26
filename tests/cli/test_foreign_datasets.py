"""Datasets that no code of this package has made are segmented as they are, whatever their layout."""

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_buds.cli.segment import segment
from lerobot_buds.core import ACTION, SKILL_ID, STATE, SUBGOAL_INDEX, DatasetError, subgoals_of
from lerobot_buds.segmentation import load_labels

pytestmark = pytest.mark.slow

FRONT = "observation.images.front"
ROBOT = "observation.images.cam_high", "observation.images.cam_left_wrist", "observation.images.cam_right_wrist"
ARMS = [f"{side}_{joint}" for side in ("left", "right") for joint in range(7)]

LAYOUTS = {
    "one camera, 14 nameless dimensions, 10 frames per second": {"state": {"shape": (14,), "names": None}, "fps": 10},
    "three cameras of three sizes, as video, names in groups": {
        "cameras": dict(zip(ROBOT, [(48, 64, 3), (64, 48, 3), (40, 40, 3)], strict=True)),
        "state": {"shape": (14,), "names": {"motors": ARMS}},
        "fps": 30,
        "video": True,
    },
    "three tasks, 50 frames per second, channels first": {
        "lengths": (60, 50, 55),
        "cameras": {FRONT: (3, 32, 48)},
        "fps": 50,
        "tasks": ["pour the tea", "wipe the table", "fold the towel"],
    },
    "14 names in a list, one of them several times, double precision": {
        "state": {"shape": (14,), "names": ["joint"] * 14, "dtype": "float64"},
        "lengths": (30, 25, 28),
    },
    "several parquet files": {"lengths": (30, 25, 28), "data_files_size_in_mb": 0.05},
    "several videos of a camera": {
        "lengths": (30, 25, 28),
        "cameras": {FRONT: (64, 64, 3)},
        "video": True,
        "video_files_size_in_mb": 0.01,
        "data_files_size_in_mb": 0.01,
    },
    "no state": {"state": {"shape": ()}, "representation": {"proprioception": []}},
    "no camera": {"cameras": {}},
    "one number of state": {"state": {"shape": (1,), "names": ["gripper"]}},
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_foreign_datasets_are_segmented_as_they_are(name, make_dataset, settings, hashes, tmp_path):
    layout = dict(LAYOUTS[name])
    changes = {"representation": layout.pop("representation", {})}
    source = make_dataset(tmp_path / "source", **layout)
    if name.startswith("several"):
        kind = "videos" if layout.get("video") else "data"
        assert len([path for path in (source / kind).rglob("*") if path.is_file()]) > 1
    before = hashes(source)
    record = segment(settings(source, tmp_path, **changes))
    assert hashes(source) == before

    skills = tmp_path / "skills"
    loaded, skill_id, subgoal_index = load_labels(skills)
    assert loaded == record and record.source.episode_lengths == layout.get("lengths", (30, 25))
    assert set(skill_id) == set(range(record.n_skills)) and 1 <= record.n_skills <= 3
    ours, theirs = LeRobotDataset("tests/foreign_skills", root=skills), LeRobotDataset("tests/foreign", root=source)
    assert ours.fps == layout.get("fps", 20) and len(ours) == len(theirs) == len(skill_id)
    columns = ours.hf_dataset.select_columns([SKILL_ID, SUBGOAL_INDEX, "index", "episode_index"]).to_dict()
    columns = {key: np.array(values).reshape(-1) for key, values in columns.items()}
    np.testing.assert_array_equal(columns[SKILL_ID], skill_id[columns["index"]])
    np.testing.assert_array_equal(columns[SUBGOAL_INDEX], subgoal_index[columns["index"]])
    for number, labels in enumerate(record.labels):
        rows = columns["episode_index"] == number
        np.testing.assert_array_equal(columns[SKILL_ID][rows], labels)
        starts = columns["index"][rows][0]
        np.testing.assert_array_equal(columns[SUBGOAL_INDEX][rows], starts + subgoals_of(labels, record.horizon))
    for index in (0, len(ours) - 1):
        mine, other = ours[index], theirs[index]
        assert mine[SKILL_ID] == skill_id[index] and mine[SUBGOAL_INDEX] == subgoal_index[index]
        assert mine["task"] == other["task"] and (mine[ACTION] == other[ACTION]).all()
        for key in {STATE, *theirs.meta.camera_keys} & set(other):
            assert (mine[key] == other[key]).all()


def test_a_dataset_without_state_is_told_how_to_go_on(make_dataset, settings, tmp_path):
    source = make_dataset(tmp_path / "source", state={"shape": ()})
    with pytest.raises(
        DatasetError, match=r"lacks 1 required.*name others in the settings(?s:.*)'observation.state'"
    ) as e:
        segment(settings(source, tmp_path))
    assert "--representation.proprioception='[]' does without a state" in str(e.value)
    assert not (tmp_path / "skills").exists() and not (tmp_path / "work").exists()
