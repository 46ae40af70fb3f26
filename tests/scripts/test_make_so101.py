"""The synthetic SO-101 dataset is as LeRobot's users record them, and a seed decides every frame."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset
from numpy.typing import NDArray

from lerobot_buds.core import ACTION, STATE, TRUE_STAGE
from lerobot_buds.data import check_demonstrations, read_table

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "scripts/make_so101.py"))
SMALL = {"episodes": 2, "seconds": 1.0, "height": 48, "width": 64}


def made(root: Path, **changes: int) -> Path:
    return Path(SCRIPT["make"](SCRIPT["So101Config"]("tests/so101", str(root), **SMALL | changes)))


@pytest.fixture(scope="module")
def so101(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("so101") / "first")


def columns(root: Path) -> dict[str, NDArray[np.float64]]:
    return dict(read_table(root, [ACTION, STATE, TRUE_STAGE]).columns)


def test_it_looks_like_a_recording(so101: Path) -> None:
    check_demonstrations(so101)
    dataset = LeRobotDataset("tests/so101", root=so101)
    assert (dataset.meta.robot_type, dataset.fps, dataset.num_episodes, len(dataset)) == ("so101_follower", 30, 2, 60)
    features = dataset.features
    assert features[STATE]["names"] == features[ACTION]["names"] == [f"{joint}.pos" for joint in SCRIPT["JOINTS"]]
    assert {name: features[name]["dtype"] for name in dataset.meta.camera_keys} == {
        "observation.images.front": "video",
        "observation.images.wrist": "video",
    }
    frame = dataset[0]
    assert frame["observation.images.front"].shape == (3, 48, 64)
    assert min(frame[camera].std() for camera in dataset.meta.camera_keys) > 0.05  # something is to be seen


def test_the_action_is_the_next_state_and_the_stages_follow_one_another(so101: Path) -> None:
    now = columns(so101)
    for start in (0, 30):
        state, action = (now[name][start : start + 30] for name in (STATE, ACTION))
        np.testing.assert_array_equal(action[:-1], state[1:])
        assert np.ptp(state[:, :5], axis=0).max() > 10  # degrees
        assert state[:, 5].min() >= 0 and state[:, 5].max() <= 100
        stages = now[TRUE_STAGE][start : start + 30]
        assert (np.diff(stages) >= 0).all() and set(stages.tolist()) == {0, 1, 2, 3}
    assert not np.array_equal(now[STATE][:30], now[STATE][30:])


def test_a_seed_decides_an_episode_however_many_there_are(so101: Path, tmp_path: Path) -> None:
    again, other = columns(made(tmp_path / "again", episodes=1)), columns(made(tmp_path / "other", seed=1))
    first = columns(so101)
    for name, column in again.items():
        np.testing.assert_array_equal(column, first[name][:30])
    assert not np.array_equal(other[STATE], first[STATE])


def test_the_hand_is_where_the_cube_is_while_it_holds_it() -> None:
    episode = SCRIPT["demonstrate"](np.random.default_rng(0), 240)
    held = np.flatnonzero(episode.stages == 2)
    tips = np.array([SCRIPT["chain"](episode.joints[t])[0][-1] for t in held])
    np.testing.assert_allclose(tips, episode.cubes[held, :3], atol=1e-12)
    first, last = episode.cubes[0], episode.cubes[-1]
    assert np.hypot(*(last[:2] - episode.disc)) < 1e-6 < np.hypot(*(first[:2] - episode.disc))
    assert first[2] == pytest.approx(last[2])  # on the table before and afterwards
