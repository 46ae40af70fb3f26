"""Recording: the same dataset for any number of workers and after a kill, and refusals before any work."""

import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock
from huggingface_hub import DatasetCard

from lerobot_buds.core import (
    ACTION,
    COLLECTION_FILE,
    EYE_IN_HAND_CAMERA,
    STATE,
    TRUE_STAGE,
    WORKSPACE_CAMERA,
    ConfigError,
    DatasetError,
    read_json,
    sha256_of_file,
)
from lerobot_buds.data import LocalDataset, cached_frames, check_demonstrations, read_table
from lerobot_buds.demos.attempts import Style
from lerobot_buds.demos.recording import Recording, record
from lerobot_buds.envs import ACTION_NAMES, STATE_NAMES, TASKS, EnvSettings

pytestmark = pytest.mark.slow

CHECKOUT = Path(__file__).parents[2]
COLLECT = "from lerobot_buds.cli.collect import main; main()"
LIKE_DEMONSTRATIONS = ["--repo_id=tests/demos", "--episodes=4", "--image_size=32", "--render_profile=fastest"]


@pytest.fixture
def recording(tmp_path):
    """Agrees with the `demonstrations` in everything but the folder."""
    settings = EnvSettings("multitask_kitchen/task3_variant1", None, 32, "fastest")
    return Recording("tests/demos", tmp_path / "demos", (settings,), episodes=4, seed=0, workers=1, video=True)


def kill_in_the_middle(root: Path) -> Path:
    """Starts the same recording with one worker and kills it after its first attempt; returns its staging folder."""
    staging = root.with_name(f".{root.name}.attempts")
    arguments = [*LIKE_DEMONSTRATIONS, f"--root={root}", "--workers=1"]
    process = subprocess.Popen(
        [sys.executable, "-c", COLLECT, *arguments], cwd=CHECKOUT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    wait_for(
        lambda: (staging / "multitask_kitchen.task3_variant1.000000.json").exists() or process.poll() is not None,
        seconds=120,
    )
    children = [int(pid) for pid in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()]
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert children
    wait_for(lambda: not any(map(running, children)), seconds=20)
    return staging


def wait_for(condition, seconds):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.05)


def running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def files(root: Path) -> dict[str, str]:
    return {str(p.relative_to(root)): sha256_of_file(p) for p in sorted(root.rglob("*")) if p.is_file()}


def test_workers_and_a_kill_do_not_change_the_dataset(demonstrations, recording, tmp_path):
    root = recording.root
    staging = kill_in_the_middle(root)
    assert not root.exists()
    # As if it had come while the dataset was joined, and another between a part and what is told of it.
    (staging / "multitask_kitchen.task3_variant1.000003.part").mkdir()
    (staging / "dataset" / "meta").mkdir(parents=True, exist_ok=True)
    (staging / "dataset" / "meta" / "half.json").write_text("{")
    attempts = {path.name: path.stat().st_mtime_ns for path in staging.glob("*.part")}

    with pytest.raises(DatasetError, match="interrupted recording with other settings"):
        record(replace(recording, seed=1))
    with pytest.raises(DatasetError, match="interrupted recording with other settings"):
        record(replace(recording, settings=(replace(recording.settings[0], render_profile="fast"),)))
    with pytest.raises(DatasetError, match="interrupted recording with other settings"):
        record(replace(recording, video=False))
    for style in (Style("people"), Style(clean_actions=True)):
        with pytest.raises(DatasetError, match="interrupted recording with other settings"):
            record(replace(recording, style=style))
    assert {path.name: path.stat().st_mtime_ns for path in staging.glob("*.part")} == attempts != {}

    summary = record(recording)
    assert (summary.episodes, summary.attempts, summary.failures) == (4, 4, {})
    assert [path.name for path in tmp_path.iterdir()] == [root.name]
    columns = [STATE, ACTION, TRUE_STAGE, "timestamp", "frame_index", "episode_index", "task_index"]
    one, two = read_table(root, columns), read_table(demonstrations, columns)
    for name in columns:
        np.testing.assert_array_equal(one.columns[name], two.columns[name])
    for camera in (WORKSPACE_CAMERA, EYE_IN_HAND_CAMERA):
        np.testing.assert_array_equal(cached_frames(root, camera), cached_frames(demonstrations, camera))
    assert files(root) == files(demonstrations)


def test_nothing_depends_on_the_order_of_a_set(demonstrations):
    """LeRobot writes statistics in such an order, which differs from process to process."""
    stats = read_json(demonstrations / "meta/stats.json")
    assert list(stats) == sorted(stats) and list(stats[STATE]) == sorted(stats[STATE])


def test_the_dataset_is_what_was_agreed(demonstrations):
    dataset = LocalDataset(demonstrations)
    assert dataset.fps == 20
    features = dataset.features
    assert features[STATE]["names"] == STATE_NAMES and features[ACTION]["names"] == ACTION_NAMES
    assert features[TRUE_STAGE]["dtype"] == "int64" and features[TRUE_STAGE]["shape"] in ([1], (1,))
    assert all(features[c]["dtype"] == "video" for c in (WORKSPACE_CAMERA, EYE_IN_HAND_CAMERA))
    assert not any("profile" in name for name in features)
    check_demonstrations(demonstrations)
    table = read_table(demonstrations, [TRUE_STAGE])
    assert len(table.starts) == 4 and len(set(table.ends - table.starts)) > 1
    for start, end in zip(table.starts, table.ends, strict=True):
        stages = table.columns[TRUE_STAGE][start:end]
        assert (np.diff(stages) >= 0).all() and set(stages) == {0, 1}


def test_the_record_tells_where_the_demonstrations_come_from(demonstrations):
    collected = read_json(demonstrations / COLLECTION_FILE)
    assert collected.pop("versions").keys() == {"lerobot_policy_buds", "lerobot", "robosuite", "mujoco"}
    assert collected == {
        "version": 2,
        "demonstrator": "scripted",
        "manner": "scripted",
        "clean_actions": False,
        "tasks": [
            {
                "name": "multitask_kitchen/task3_variant1",
                "description": TASKS["multitask_kitchen/task3_variant1"].description,
                "episode_seeds": [0, 1, 2, 3],
                "retries": [[], [], [], []],
                "failed_attempts": [],
            }
        ],
        "stages": ["close_drawer", "push_pot"],
        "render_profile": "fastest",
        "image_size": 32,
    }


def test_the_card_tells_what_is_in_the_dataset(demonstrations):
    card = DatasetCard.load(demonstrations / "README.md")
    assert card.data.task_categories == ["robotics"] and "LeRobot" in card.data.tags
    table = read_table(demonstrations, [])
    lengths = table.ends - table.starts
    assert f"4 episodes, {lengths.sum()} frames at 20 Hz" in card.text
    assert f"| 4 | 0 | {lengths.mean():.0f} ({lengths.min()} to {lengths.max()}) | 0 to 3 |" in card.text
    assert "Manner" not in card.text and "clean_actions" not in card.text
    (picture,) = re.findall(r"!\[.*\]\((.*)\)", card.text)
    assert (demonstrations / picture).is_file()


def test_record_and_card_tell_the_manner_what_was_done_again_and_that_actions_are_clean(recording):
    settings = (replace(recording.settings[0], image_size=16),)
    style = Style("people", clean_actions=True)
    record(replace(recording, settings=settings, episodes=1, video=False, style=style))
    collected = read_json(recording.root / COLLECTION_FILE)
    assert (collected["manner"], collected["clean_actions"]) == ("people", True)
    ((retries,),) = [task["retries"] for task in collected["tasks"]]
    card = DatasetCard.load(recording.root / "README.md").text
    assert "Manner `people`" in card and "--clean_actions" in card
    again = ", ".join(f"{stage} {retries.count(stage)}" for stage in sorted(set(retries))) or "nothing"
    assert f"Missed and done again, by stage: {again}." in card


def test_several_tasks_go_into_one_dataset_with_one_count_of_stages(recording):
    settings = tuple(
        EnvSettings(f"multitask_kitchen/{name}", None, 32, "fastest") for name in ("task3_variant1", "task1_variant3")
    )
    summary = record(replace(recording, settings=settings, episodes=1, workers=2))
    assert (summary.episodes, summary.attempts) == (2, 2)
    stages = read_json(recording.root / COLLECTION_FILE)["stages"]
    assert stages == ["close_drawer", "push_pot", "turn_on", "cube_in_pot", "pot_on_stove"]
    table = read_table(recording.root, [TRUE_STAGE, "task_index"])
    seen = [
        {stages[number] for number in table.columns[TRUE_STAGE][start:end]}
        for start, end in zip(table.starts, table.ends, strict=True)
    ]
    assert seen == [{"close_drawer", "push_pot"}, {"turn_on", "cube_in_pot", "pot_on_stove"}]
    assert [table.columns["task_index"][start] for start in table.starts] == [0, 1]


def test_images_are_stored_as_they_are_drawn_by_any_number_of_workers(recording, tmp_path):
    settings = (replace(recording.settings[0], image_size=16),)
    images = replace(recording, episodes=2, video=False, settings=settings)
    summary = record(images)
    assert summary.episodes == 2 and summary.frames > 120
    frames = cached_frames(recording.root, WORKSPACE_CAMERA, tmp_path / "cache")
    assert frames.shape == (summary.frames, 3, 16, 16) and frames.std() > 15
    assert not [path for path in recording.root.rglob("*") if path.suffix == ".mp4" or "images" in path.parts[:-2]]
    before = files(recording.root)
    with pytest.raises(DatasetError, match="exists already"):
        record(recording)
    assert files(recording.root) == before
    record(replace(images, root=tmp_path / "other", workers=3))
    assert files(tmp_path / "other") == before


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seed": 99_990}, "Seeds from 100000 on are for evaluation"),
        ({"seed": 100_000}, "Seeds from 100000 on are for evaluation"),
        ({"seed": 0, "episodes": 50_000}, "Seeds from 100000 on are for evaluation"),
        ({"seed": -1}, "seed=-1 cannot work"),
        ({"episodes": 0}, "episodes=0 cannot work"),
        ({"workers": -1}, "workers=-1 cannot work"),
        (
            {"settings": (EnvSettings("multitask_kitchen/task3_variant1", None, 16),)},
            "is 16 x 16 pixels, but video has at least 32 a side",
        ),
    ],
)
def test_what_cannot_work_is_refused_before_anything_is_written(recording, tmp_path, change, said):
    with pytest.raises(ConfigError, match=said):
        record(replace(recording, **change))
    assert list(tmp_path.iterdir()) == []


def test_two_recordings_of_one_dataset_are_refused(recording, tmp_path):
    staging = tmp_path / ".demos.attempts"
    staging.mkdir()
    with FileLock(staging / "lock"), pytest.raises(DatasetError, match="Another process is recording"):
        record(recording)
    shutil.rmtree(staging)
    assert list(tmp_path.iterdir()) == []
