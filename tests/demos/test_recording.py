"""Recording: the same dataset for any number of workers and after a kill, and refusals before any work."""

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
from lerobot_buds.demos import DatasetFiles, cached_frames, check_demonstrations, read_table
from lerobot_buds.demos.recording import Recording, record
from lerobot_buds.envs import ACTION_NAMES, STATE_NAMES, EnvSettings

CHECKOUT = Path(__file__).parents[2]
COLLECT = "from lerobot_buds.cli.collect import main; main()"
LIKE_DEMONSTRATIONS = ["--repo_id=tests/demos", "--episodes=4", "--image_size=32", "--render_profile=fastest"]


@pytest.fixture
def recording(tmp_path):
    """Agrees with the `demonstrations` in everything but the folder."""
    settings = EnvSettings("multitask_kitchen/task3_variant1", None, 32, "fastest")
    return Recording("tests/demos", tmp_path / "demos", settings, episodes=4, seed=0, workers=1, video=True)


def kill_in_the_middle(root: Path) -> Path:
    """Starts the same recording with one worker and kills it after its first attempt; returns its staging folder."""
    staging = root.with_name(f".{root.name}.attempts")
    arguments = [*LIKE_DEMONSTRATIONS, f"--root={root}", "--workers=1"]
    process = subprocess.Popen(
        [sys.executable, "-c", COLLECT, *arguments], cwd=CHECKOUT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    wait_for(lambda: (staging / "000000.json").exists() or process.poll() is not None, seconds=120)
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
    # As if the kill had come while the dataset was written.
    (staging / "dataset" / "meta").mkdir(parents=True)
    (staging / "dataset" / "meta" / "half.json").write_text("{")
    attempts = {path.name: path.stat().st_mtime_ns for path in staging.glob("0*.npz")}

    with pytest.raises(DatasetError, match="interrupted recording with other settings"):
        record(replace(recording, seed=1))
    with pytest.raises(DatasetError, match="interrupted recording with other settings"):
        record(replace(recording, settings=replace(recording.settings, render_profile="fast")))
    assert {path.name: path.stat().st_mtime_ns for path in staging.glob("0*.npz")} == attempts

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


def test_the_dataset_is_what_was_agreed(demonstrations):
    dataset = DatasetFiles(demonstrations)
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
        "version": 1,
        "demonstrator": "scripted",
        "task": "multitask_kitchen/task3_variant1",
        "stages": ["close_drawer", "push_pot"],
        "render_profile": "fastest",
        "image_size": 32,
        "episode_seeds": [0, 1, 2, 3],
        "failed_attempts": [],
    }


def test_images_are_stored_as_they_are_drawn(recording, tmp_path):
    summary = record(replace(recording, episodes=1, video=False, settings=replace(recording.settings, image_size=16)))
    assert summary.episodes == 1 and summary.frames > 60
    frames = cached_frames(recording.root, WORKSPACE_CAMERA, tmp_path / "cache")
    assert frames.shape == (summary.frames, 3, 16, 16) and frames.std() > 15
    assert not [path for path in recording.root.rglob("*") if path.suffix == ".mp4" or "images" in path.parts[:-2]]
    before = files(recording.root)
    with pytest.raises(DatasetError, match="exists already"):
        record(recording)
    assert files(recording.root) == before


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seed": 99_990}, "Seeds from 100000 on are for evaluation"),
        ({"seed": 100_000}, "Seeds from 100000 on are for evaluation"),
        ({"seed": 0, "episodes": 50_000}, "Seeds from 100000 on are for evaluation"),
        ({"seed": -1}, "seed=-1 cannot work"),
        ({"episodes": 0}, "episodes=0 cannot work"),
        ({"workers": -1}, "workers=-1 cannot work"),
        ({"settings": EnvSettings("multitask_kitchen", None, 16)}, "image_size=16 cannot work; it must be at least 32"),
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
