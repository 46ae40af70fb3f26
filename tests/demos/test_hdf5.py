import json
import os
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from filelock import FileLock
from lerobot.datasets import LeRobotDataset

from lerobot_buds.cli.import_hdf5 import main
from lerobot_buds.core import ConfigError, DatasetError, read_json, sha256_of_file
from lerobot_buds.data import cached_frames, read_table
from lerobot_buds.demos import importing
from lerobot_buds.demos.hdf5 import Source, open_demonstrations
from lerobot_buds.demos.importing import Import, Imported, import_demonstrations
from lerobot_buds.envs import ACTION_NAMES, STATE_NAMES

pytestmark = pytest.mark.slow

WORKSPACE, EYE_IN_HAND = "observation.images.agentview", "observation.images.eye_in_hand"
LENGTHS = {0: 5, 1: 7, 2: 4, 10: 6}  # 10 sorts before 2 as text
SIZE = 64


class Episode:
    """What happened in one episode: T + 1 observations, and the T actions between them."""

    def __init__(self, number: int) -> None:
        rng = np.random.default_rng(number)
        length = LENGTHS[number]
        self.actions = rng.uniform(-1, 1, (length, 4))
        self.joints, self.fingers, self.hand = (rng.normal(size=(length + 1, d)) for d in (7, 2, 3))
        self.images = [rng.integers(0, 256, (length + 1, SIZE, SIZE, 3), dtype=np.uint8) for _ in range(2)]

    @property
    def state(self) -> np.ndarray:
        return np.hstack([self.joints, self.fingers, self.hand]).astype(np.float32)


EPISODES = {number: Episode(number) for number in LENGTHS}


def write_robomimic(path: Path) -> Path:
    """Row t: the observation before action t, which is what robomimic's own script stores."""
    with h5py.File(path, "w") as file:
        file.create_group("data").attrs["env_args"] = json.dumps({"env_name": "Lift"})
        for number, episode in EPISODES.items():
            group = file.create_group(f"data/demo_{number}")
            group["actions"] = episode.actions
            group["states"] = np.zeros((len(episode.actions), 9))
            for name, values in [
                ("robot0_joint_pos", episode.joints),
                ("robot0_gripper_qpos", episode.fingers),
                ("robot0_eef_pos", episode.hand),
                ("agentview_image", episode.images[0]),
                ("robot0_eye_in_hand_image", episode.images[1]),
            ]:
                group[f"obs/{name}"] = values[:-1]
        file["mask/train"] = np.array(["demo_2", "demo_0"], dtype="S")
    return path


def write_buds(path: Path) -> Path:
    """Row j: the observation after action j, images pooled; what the release's script stores."""
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        for number, episode in enumerate(EPISODES.values()):
            group = data.create_group(f"ep_{number}")
            group["actions"] = episode.actions
            group["joint_states"] = episode.joints[1:]
            group["gripper_states"] = episode.fingers[1:]
            group["proprio_states"] = np.hstack([episode.hand, episode.fingers])[1:]
            group["gt_states"] = np.zeros((len(episode.actions) + 5, 9))
        for camera, name in enumerate(("agentview_images", "eye_in_hand_images")):
            images = [episode.images[camera][1:] for episode in EPISODES.values()]
            data[name] = np.concatenate(images).transpose(0, 3, 1, 2)
        data.create_group("task").attrs["3"] = np.array([1, 3])
    return path


@pytest.fixture
def robomimic(tmp_path: Path) -> Path:
    return write_robomimic(tmp_path / "image.hdf5")


@pytest.fixture
def buds(tmp_path: Path) -> Path:
    return write_buds(tmp_path / "demo.hdf5")


def imported(path: Path, video: bool = False, **source: object) -> tuple[Path, Imported]:
    root = path.parent / "out/dataset"
    plan = Import(Source(path, **source), "test/imported", root, "lift the cube", fps=20, video=video)
    return root, import_demonstrations(plan, cache_dir=path.parent / "cache")


def test_robomimic_rows_keep_their_pairs(robomimic: Path) -> None:
    before = sha256_of_file(robomimic)
    root, result = imported(robomimic)
    assert (result.episodes, result.frames, result.warnings) == (4, sum(LENGTHS.values()), [])
    table = read_table(root, ["observation.state", "action"])
    assert (table.ends - table.starts).tolist() == list(LENGTHS.values())
    views = [cached_frames(root, camera, robomimic.parent / "cache") for camera in (WORKSPACE, EYE_IN_HAND)]
    for start, end, episode in zip(table.starts, table.ends, EPISODES.values(), strict=True):
        for t in range(end - start):
            assert np.array_equal(table.columns["observation.state"][start + t], episode.state[t])
            assert np.array_equal(table.columns["action"][start + t], episode.actions[t].astype(np.float32))
            for view, images in zip(views, episode.images, strict=True):
                assert np.array_equal(view[start + t], images[t].transpose(2, 0, 1))
    assert sha256_of_file(robomimic) == before


@pytest.mark.parametrize("alignment", ["lerobot", "released"])
def test_buds_rows_pair_an_observation_with_the_action_after_it(buds: Path, alignment: str) -> None:
    root, _ = imported(buds, alignment=alignment)
    table = read_table(root, ["observation.state", "action"])
    views = [cached_frames(root, camera, buds.parent / "cache") for camera in (WORKSPACE, EYE_IN_HAND)]
    shift = 1 if alignment == "lerobot" else 0
    assert (table.ends - table.starts).tolist() == [length - shift for length in LENGTHS.values()]
    for start, end, episode in zip(table.starts, table.ends, EPISODES.values(), strict=True):
        for t in range(end - start):
            # The first observation of the file is the one after the first action: number t + 1 of the episode.
            assert np.array_equal(table.columns["observation.state"][start + t], episode.state[t + 1])
            assert np.array_equal(table.columns["action"][start + t], episode.actions[t + shift].astype(np.float32))
            for view, images in zip(views, episode.images, strict=True):
                assert np.array_equal(view[start + t], images[t + 1].transpose(2, 0, 1))


def test_videos_hold_every_frame_and_lerobot_reads_the_dataset(robomimic: Path) -> None:
    root, _ = imported(robomimic, video=True)
    dataset = LeRobotDataset("test/imported", root=root)
    assert (dataset.num_episodes, dataset.num_frames, dataset.fps) == (4, sum(LENGTHS.values()), 20)
    assert dataset.features["observation.state"]["names"] == STATE_NAMES
    assert dataset.features["action"]["names"] == ACTION_NAMES
    truth = np.concatenate([episode.images[0][:-1] for episode in EPISODES.values()]) / 255
    for index in range(dataset.num_frames):
        item = dataset[index]
        assert item["task"] == "lift the cube"
        # Noise survives encoding well enough to tell every frame from every other.
        distances = ((truth - item[WORKSPACE].numpy().transpose(1, 2, 0)) ** 2).mean(axis=(1, 2, 3))
        assert distances.argmin() == index


def test_the_record_tells_where_the_demonstrations_are_from(buds: Path) -> None:
    root, _ = imported(buds)
    record = read_json(root / "meta/buds/collection.json")
    assert record["demonstrator"] == "imported"
    assert (record["layout"], record["alignment"], record["fps"]) == ("buds", "lerobot", 20)
    assert record["source"]["path"] == "demo.hdf5"
    assert record["source"]["sha256"] == sha256_of_file(buds)
    assert record["episode_names"] == ["ep_0", "ep_1", "ep_2", "ep_3"]


def test_other_arrays_flipped_images_and_filters(robomimic: Path) -> None:
    source = Source(
        robomimic,
        cameras={"front": "robot0_eye_in_hand_image"},
        state=("robot0_eef_pos", "robot0_joint_pos"),
        orientation="flipped",
        filter_key="train",
    )
    with open_demonstrations(source) as demonstrations:
        assert demonstrations.lengths == {"demo_0": 5, "demo_2": 4}
        assert demonstrations.state_names == [*STATE_NAMES[9:], *STATE_NAMES[:7]]
        arrays = demonstrations.read("demo_2")
    assert arrays.keys() == {"observation.state", "action", "observation.images.front"}
    assert np.array_equal(arrays["observation.images.front"], EPISODES[2].images[1][:-1, ::-1])


def test_unusual_widths_get_numbered_names(robomimic: Path) -> None:
    with h5py.File(robomimic, "r+") as file:
        for number, length in LENGTHS.items():
            del file[f"data/demo_{number}/actions"], file[f"data/demo_{number}/obs/robot0_joint_pos"]
            file[f"data/demo_{number}/actions"] = np.zeros((length, 7))
            file[f"data/demo_{number}/obs/robot0_joint_pos"] = np.zeros((length, 2))
    with open_demonstrations(Source(robomimic)) as demonstrations:
        assert demonstrations.action_names == [f"action_{d}" for d in range(7)]
        assert demonstrations.state_names == ["robot0_joint_pos_0", "robot0_joint_pos_1", *STATE_NAMES[7:]]


def test_a_task_of_the_release_keeps_its_own_images(buds: Path) -> None:
    with open_demonstrations(Source(buds, filter_key="3")) as demonstrations:
        assert demonstrations.lengths == {"ep_1": 6, "ep_3": 5}
        assert np.array_equal(demonstrations.read("ep_3")[WORKSPACE], EPISODES[10].images[0][1:-1])
    with (
        pytest.raises(DatasetError, match=r"filter_key='4' selects nothing.*Known: '3'"),
        open_demonstrations(Source(buds, filter_key="4")),
    ):
        pass


@pytest.mark.parametrize("video", [False, True])
def test_an_interrupted_import_goes_on(robomimic: Path, monkeypatch: pytest.MonkeyPatch, video: bool) -> None:
    write, written = importing.write_part, []

    def counting(*rest: object) -> None:
        written.append(rest)
        write(*rest)

    def dying(*rest: object) -> None:
        if len(written) == 2:
            raise KeyboardInterrupt  # before the third is there
        counting(*rest)

    monkeypatch.setattr(importing, "write_part", dying)
    with pytest.raises(KeyboardInterrupt):
        imported(robomimic, video)
    monkeypatch.setattr(importing, "write_part", counting)
    staging = robomimic.parent / "out/.dataset.import"
    (staging / "merged").mkdir()  # what a kill while merging leaves
    with pytest.raises(DatasetError, match="other settings"):
        imported(robomimic, video, orientation="flipped")
    root, result = imported(robomimic, video)
    assert len(written) == 4 and result.episodes == 4
    assert read_table(root, ["action"]).columns["action"].shape == (sum(LENGTHS.values()), 4)
    assert not staging.exists()
    with pytest.raises(DatasetError, match="exists already"):
        imported(robomimic, video)


def test_a_second_import_of_the_same_dataset_is_refused(robomimic: Path) -> None:
    (robomimic.parent / "out").mkdir()
    with (
        FileLock(robomimic.parent / "out/.dataset.lock"),
        pytest.raises(DatasetError, match="Another process is writing"),
    ):
        imported(robomimic)


def refusal(path: Path, **source: object) -> str:
    with pytest.raises(DatasetError) as caught:
        imported(path, **source)
    assert not (path.parent / "out").exists(), "nothing may be written before the source is known to be sound"
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_a_truncated_file_is_refused(robomimic: Path) -> None:
    os.truncate(robomimic, robomimic.stat().st_size // 2)
    assert "cut off" in refusal(robomimic)


def test_a_file_damaged_inside_is_refused_and_leaves_no_dataset(tmp_path: Path) -> None:
    path = write_robomimic(tmp_path / "packed.hdf5")
    with h5py.File(path, "r+") as file:
        images = file["data/demo_2/obs/agentview_image"][()]
        del file["data/demo_2/obs/agentview_image"]
        file.create_dataset("data/demo_2/obs/agentview_image", data=images, chunks=(1, 64, 64, 3), fletcher32=True)
        offset = file["data/demo_2/obs/agentview_image"].id.get_chunk_info(3).byte_offset
    with path.open("r+b") as file:
        file.seek(offset)
        file.write(bytes(100))
    with pytest.raises(DatasetError, match="data/demo_2/obs/agentview_image is damaged"):
        imported(path)
    assert not (tmp_path / "out/dataset").exists()


def test_all_missing_arrays_are_named_at_once(robomimic: Path) -> None:
    with h5py.File(robomimic, "r+") as file:
        for number in LENGTHS:
            file.move(f"data/demo_{number}/obs/agentview_image", f"data/demo_{number}/obs/agentview_rgb_image")
        del file["data/demo_10/actions"]
    message = refusal(robomimic)
    assert "lacks 2 array(s)" in message
    assert "'data/demo_0/obs/agentview_image' and 3 more: Did you mean 'agentview_rgb_image'?" in message
    assert "'data/demo_10/actions': " in message


def test_a_file_of_states_alone_is_explained(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "raw.hdf5", "w") as file:
        file["data/demo_1/actions"], file["data/demo_1/states"] = np.zeros((5, 4)), np.zeros((5, 9))
    assert "has to be rendered first" in refusal(tmp_path / "raw.hdf5")


@pytest.mark.parametrize(
    ("array", "message"),
    [
        ("data/demo_2/obs/agentview_image", "agentview_image has 3 rows, but demo_2 has 4 actions"),
        ("data/demo_2/obs/robot0_eef_pos", "robot0_eef_pos has 3 rows, but demo_2 has 4 actions"),
        ("data/demo_2/actions", "robot0_joint_pos has 4 rows, but demo_2 has 3 actions"),
    ],
)
def test_unequal_lengths_are_refused(robomimic: Path, array: str, message: str) -> None:
    with h5py.File(robomimic, "r+") as file:
        values = file[array][:-1]
        del file[array]
        file[array] = values
    assert message in refusal(robomimic)


def test_pooled_images_must_be_as_many_as_the_actions(buds: Path) -> None:
    with h5py.File(buds, "r+") as file:
        images = file["data/eye_in_hand_images"][:-1]
        del file["data/eye_in_hand_images"]
        file["data/eye_in_hand_images"] = images
    assert "eye_in_hand_images has 21 rows, but the file has 22 actions" in refusal(buds)


@pytest.mark.parametrize(
    ("array", "value", "message"),
    [
        (
            "obs/robot0_gripper_qpos",
            np.nan,
            r"'observation.state' is nan in demo_1, frame 3, dimension 8 ('gripper_right.pos')",
        ),
        ("actions", -np.inf, "'action' is -inf in demo_1, frame 3, dimension 1 ('delta_y.pos')"),
    ],
)
def test_values_that_are_not_finite_are_located(robomimic: Path, array: str, value: float, message: str) -> None:
    with h5py.File(robomimic, "r+") as file:
        file[f"data/demo_1/{array}"][3, 1] = value
    assert message in refusal(robomimic)


def test_images_of_another_kind_are_refused(robomimic: Path) -> None:
    assert "wanted are uint8 RGB images" in refusal(robomimic, cameras={"front": "robot0_eef_pos"})
    with h5py.File(robomimic, "r+") as file:
        del file["data/demo_2/obs/agentview_image"]
        file["data/demo_2/obs/agentview_image"] = np.zeros((4, 32, 32, 3), dtype=np.uint8)
    assert "of one size in all demonstrations" in refusal(robomimic)


def test_settings_that_cannot_work_are_refused(robomimic: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="Did you mean 'robomimic'"):
        imported(robomimic, layout="robomimick")
    with pytest.raises(ConfigError, match="Did you mean 'released'"):
        imported(robomimic, alignment="release")
    with pytest.raises(ConfigError, match="means nothing for the robomimic layout"):
        imported(robomimic, alignment="released")
    assert "data/ep_<number> (buds)" in refusal(robomimic, layout="buds")
    for task, fps in ((" ", 20), ("lift", 0)):
        with pytest.raises(ConfigError, match="must"):
            import_demonstrations(Import(Source(robomimic), "test/imported", tmp_path / "out", task, fps))


def test_episodes_without_a_frame_are_refused(buds: Path) -> None:
    with h5py.File(buds, "w") as file:
        for key, values in {"actions": (1, 4), "joint_states": (1, 7), "gripper_states": (1, 2)}.items():
            file[f"data/ep_0/{key}"] = np.zeros(values)
        file["data/ep_0/proprio_states"] = np.zeros((1, 6))
        file["data/agentview_images"] = file["data/eye_in_hand_images"] = np.zeros((1, 3, 8, 8), dtype=np.uint8)
    assert "ep_0 have no frame" in refusal(buds)


def test_the_command_imports_and_shows_errors_in_one_line(
    robomimic: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--repo_id=test/imported", "--task=lift", "--fps=20", "--video=false", f"--root={tmp_path / 'out'}"]
    options += ["--cameras={front: agentview_image}", "--state=[robot0_eef_pos, robot0_gripper_qpos]"]
    monkeypatch.setattr("lerobot_buds.data.store.HF_LEROBOT_HOME", tmp_path)
    monkeypatch.setattr("sys.argv", ["lerobot-buds-import", f"--source={tmp_path / 'absent.hdf5'}", *options])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert re.fullmatch(r"error: .*absent.hdf5 does not exist; name the HDF5 file with --source\.", str(stopped.value))
    monkeypatch.setattr("sys.argv", ["lerobot-buds-import", f"--source={robomimic}", *options])
    main()
    assert capsys.readouterr().out.splitlines()[-1] == "4 demonstrations, 22 frames"
    assert read_table(tmp_path / "out", ["observation.state"]).columns["observation.state"].shape == (22, 5)
