"""What files say themselves: their layout, rate, task, how images lie, and where stages end."""

import json
import logging
from pathlib import Path

import h5py
import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_buds.core import BudsError, ConfigError, DatasetError, read_json
from lerobot_buds.data import cached_frames, read_collection, read_table
from lerobot_buds.demos.hdf5 import Source, open_demonstrations
from lerobot_buds.demos.importing import Import, import_demonstrations

T, SIZE = 6, 32
BOWL, STOVE = "put the black bowl on the plate", "turn on the stove"
ROBOMIMIC_VECTORS = {"robot0_joint_pos": 7, "robot0_gripper_qpos": 2, "robot0_eef_pos": 3}


def write_libero(path: Path, words: str = BOWL, convention: str | None = "opengl", rate: float | None = 20) -> Path:
    """Row t of ``obs`` is what was seen after action t; row t of ``actions`` is filled with t."""
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["problem_info"] = json.dumps({"language_instruction": words})
        data.attrs["bddl_file_name"] = "x.bddl"
        data.attrs["env_args"] = json.dumps(
            {"env_name": "Libero", "env_kwargs": {"control_freq": rate} if rate else {}}
        )
        if convention:
            data.attrs["macros_image_convention"] = convention
        for number in range(2):
            group = data.create_group(f"demo_{number}")
            group["actions"] = np.repeat(np.arange(T)[:, None], 7, axis=1).astype(float)
            for name, width in {"gripper_states": 2, "joint_states": 7, "ee_pos": 3, "ee_ori": 3}.items():
                group[f"obs/{name}"] = np.repeat(np.arange(T)[:, None], width, axis=1) + 0.5
            for name in ("agentview_rgb", "eye_in_hand_rgb"):
                group[f"obs/{name}"] = pictures(T)
    return path


def pictures(count: int) -> np.ndarray:
    """Black but for a white corner, top left as stored, and the frame's number in its last pixel."""
    images = np.zeros((count, SIZE, SIZE, 3), dtype=np.uint8)
    images[:, :4, :4] = 255
    images[:, -1, -1] = np.arange(count)[:, None] + 100
    return images


def write_robomimic(path: Path, images: tuple[str, ...] = (), **attributes: object) -> Path:
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps({"env_name": "Lift", "env_kwargs": {"control_freq": 20}})
        for number in range(2):
            group = data.create_group(f"demo_{number}")
            group["actions"] = np.full((T, 7), number, dtype=float)
            for name, width in ROBOMIMIC_VECTORS.items():
                group[f"obs/{name}"] = np.random.default_rng(number).normal(size=(T, width))
            for name in images:
                group[f"obs/{name}"] = pictures(T)
            for name, value in attributes.items():
                group.attrs[name] = value
    return path


def write_mimicgen(path: Path) -> Path:
    write_robomimic(path, images=("agentview_image", "robot0_eye_in_hand_image"))
    with h5py.File(path, "r+") as file:
        for number, ends in enumerate(({"grasp": 2, "place": 4}, {"grasp": 1, "place": 5})):
            for name, end in ends.items():
                file[f"data/demo_{number}/datagen_info/subtask_term_signals/{name}"] = (np.arange(T) >= end) * 1
    return path


def imported(source: Source, tmp_path: Path, **settings: object) -> Path:
    root = tmp_path / "dataset"
    plan = Import(source, "test/imported", root, **{"video": False, **settings})
    import_demonstrations(plan, cache_dir=tmp_path / "cache")
    return root


def test_libero_pairs_an_observation_with_the_action_after_it(tmp_path: Path) -> None:
    root = imported(Source(write_libero(tmp_path / "bowl_demo.hdf5")), tmp_path)
    table = read_table(root, ["observation.state", "action"])
    assert table.ends.tolist() == [T - 1, 2 * (T - 1)]
    # What was seen after action t, t + 0.5, belongs to action t + 1.
    assert np.array_equal(table.columns["action"][: T - 1, 0], np.arange(1, T))
    assert np.allclose(table.columns["observation.state"][: T - 1], np.arange(T - 1)[:, None] + 0.5)
    dataset = LeRobotDataset("test/imported", root=root)
    assert {dataset[index]["task"] for index in range(len(dataset))} == {BOWL}
    names = ["eef_x.pos", "eef_y.pos", "eef_z.pos", "eef_axisangle_x", "eef_axisangle_y", "eef_axisangle_z"]
    assert dataset.features["observation.state"]["names"] == [*names, "gripper_left.pos", "gripper_right.pos"]
    assert read_json(root / "meta/info.json")["fps"] == 20
    assert isinstance(read_json(root / "meta/info.json")["fps"], int)


@pytest.mark.parametrize(
    ("convention", "orientation", "corner"),
    [
        ("opengl", None, (-1, -1)),  # by 180 degrees, as LeRobot turns those of its LIBERO environment
        ("opengl", "flipped", (-1, 0)),
        ("opengl", "stored", (0, 0)),
        ("opencv", None, (0, 0)),
    ],
)
def test_libero_images_are_turned_as_lerobot_turns_them(
    tmp_path: Path, convention: str, orientation: str | None, corner: tuple[int, int]
) -> None:
    path = write_libero(tmp_path / "x_demo.hdf5", convention=convention)
    root = imported(Source(path, orientation=orientation), tmp_path)
    frames = cached_frames(root, "observation.images.agentview", tmp_path / "cache")
    assert (frames[0, :, corner[0], corner[1]] == 255).all()
    # The first frame is the one that the file has first; its last one has no action after it.
    assert sorted(set(frames.reshape(len(frames), -1).min(axis=1).tolist())) == [0]
    across = (-1 - corner[0], -1 - corner[1])
    assert frames[: T - 1, 0, across[0], across[1]].tolist() == [100 + t for t in range(T - 1)]
    told = read_collection(root)
    assert told["facts"]["orientation"] == orientation or {"opengl": "rotated", "opencv": "stored"}[convention]


def test_a_file_that_does_not_say_how_its_images_lie_is_refused(tmp_path: Path) -> None:
    path = write_libero(tmp_path / "x_demo.hdf5", convention=None)
    with pytest.raises(DatasetError, match=r"does not say how its images lie.*--orientation") as refused:
        imported(Source(path), tmp_path)
    assert "--alignment=released" in str(refused.value)
    root = imported(Source(path, orientation="stored", alignment="released"), tmp_path)
    assert read_table(root, ["action"]).ends[0] == T
    imported(Source(path, cameras={}), tmp_path / "none")  # without images there is nothing to turn


def test_a_folder_of_files_one_a_task_becomes_one_dataset(tmp_path: Path) -> None:
    folder = tmp_path / "libero"
    folder.mkdir()
    write_libero(folder / "b_stove_demo.hdf5", STOVE)
    write_libero(folder / "a_bowl_demo.hdf5", BOWL)
    (folder / "notes.txt").write_text("no demonstrations")
    root = imported(Source(folder), tmp_path)
    dataset = LeRobotDataset("test/imported", root=root)
    assert dataset.num_episodes == 4
    assert [dataset[index]["task"] for index in (0, T - 1, 2 * (T - 1), 3 * (T - 1))] == [BOWL, BOWL, STOVE, STOVE]
    record = read_collection(root)
    assert record["episode_names"][::2] == ["a_bowl_demo.demo_0", "b_stove_demo.demo_0"]
    assert record["source"]["files"].keys() == {"a_bowl_demo.hdf5", "b_stove_demo.hdf5"}
    assert record["task"] is None and record["episode_tasks"] == [BOWL, BOWL, STOVE, STOVE]


def test_files_that_do_not_go_together_are_refused(tmp_path: Path) -> None:
    write_libero(tmp_path / "a_demo.hdf5")
    write_libero(tmp_path / "b_demo.hdf5", rate=10)
    with pytest.raises(DatasetError, match=r"b_demo.hdf5 and .*a_demo.hdf5 do not go into one dataset: fps is 10"):
        imported(Source(tmp_path), tmp_path / "out")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match="is a folder without HDF5 files"):
        imported(Source(tmp_path / "empty"), tmp_path / "out")


@pytest.mark.parametrize("layout", ["robomimic", "mimicgen", "robosuite", "buds"])
def test_a_layout_that_the_file_contradicts_is_refused(tmp_path: Path, layout: str) -> None:
    with pytest.raises(DatasetError):
        imported(Source(write_libero(tmp_path / "x_demo.hdf5"), layout=layout), tmp_path)


def test_a_file_of_two_layouts_is_ambiguous(tmp_path: Path) -> None:
    path = write_libero(tmp_path / "x.hdf5")
    with h5py.File(path, "r+") as file:
        file["data/ep_0/actions"] = np.zeros((T, 7))
    with pytest.raises(DatasetError, match="of two layouts; say which are meant with --layout"):
        imported(Source(path), tmp_path)
    assert read_collection(imported(Source(path, layout="libero"), tmp_path))["layout"] == "libero"


def test_the_signals_of_mimicgen_become_true_stages(tmp_path: Path) -> None:
    root = imported(Source(write_mimicgen(tmp_path / "stack.hdf5")), tmp_path)
    stages = read_table(root, ["true_stage"]).columns["true_stage"]
    assert stages.dtype == np.int64
    assert stages.reshape(2, T).tolist() == [[0, 0, 1, 1, 2, 2], [0, 1, 1, 1, 1, 2]]
    record = read_collection(root)
    assert (record["layout"], record["stages"]) == ("mimicgen", ["grasp", "place", "to_the_end"])
    assert read_json(root / "meta/info.json")["features"]["true_stage"]["shape"] == [1]


def test_stages_done_in_another_order_keep_their_numbers(tmp_path: Path) -> None:
    path = write_mimicgen(tmp_path / "stack.hdf5")
    with h5py.File(path, "r+") as file:
        signals = file["data/demo_1/datagen_info/subtask_term_signals"]
        signals["grasp"][...], signals["place"][...] = np.arange(T) >= 4, np.arange(T) >= 3
        del file["data/demo_0/datagen_info/subtask_term_signals/place"]
        file["data/demo_0/datagen_info/subtask_term_signals/place"] = np.zeros(T)  # never ends
    with open_demonstrations(Source(path, cameras={})) as demonstrations:
        assert demonstrations.stages == ("grasp", "place", "to_the_end")
        assert demonstrations.read("demo_0")["true_stage"][:, 0].tolist() == [0, 0, 2, 2, 2, 2]
        assert demonstrations.read("demo_1")["true_stage"][:, 0].tolist() == [1, 1, 1, 0, 2, 2]
    with open_demonstrations(Source(path, layout="robomimic", cameras={})) as demonstrations:
        assert demonstrations.stages == () and "true_stage" not in demonstrations.read("demo_0")


def test_files_without_images_become_datasets_of_states(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    root = imported(Source(write_robomimic(tmp_path / "low_dim.hdf5")), tmp_path, video=True)
    assert "there are no images; the dataset will have no cameras" in caplog.text
    assert {name for name in read_json(root / "meta/info.json")["features"] if "." in name} == {"observation.state"}
    assert read_table(root, ["observation.state"]).columns["observation.state"].shape == (2 * T, 12)


def test_empty_cameras_and_state_mean_none(tmp_path: Path) -> None:
    path = write_robomimic(tmp_path / "image.hdf5", images=("agentview_image", "robot0_eye_in_hand_image"))
    root = imported(Source(path, cameras={}, state=[]), tmp_path)
    features = read_json(root / "meta/info.json")["features"]
    assert not [name for name in features if name.startswith("observation")] and "action" in features


def test_robocasa_says_its_task_by_the_episode(tmp_path: Path) -> None:
    cameras = ("robot0_agentview_left_image", "robot0_agentview_right_image", "robot0_eye_in_hand_image")
    path = write_robomimic(tmp_path / "casa.hdf5", images=cameras)
    with h5py.File(path, "r+") as file:
        for number, words in enumerate(("open the drawer", "close the drawer")):
            file[f"data/demo_{number}"].attrs["ep_meta"] = json.dumps({"lang": words})
    root = imported(Source(path), tmp_path)
    record = read_collection(root)
    assert (record["layout"], record["episode_tasks"]) == ("robocasa", ["open the drawer", "close the drawer"])
    cameras = [name for name in read_json(root / "meta/info.json")["features"] if "images" in name]
    assert sorted(cameras) == [f"observation.images.{n}" for n in ("agentview_left", "agentview_right", "eye_in_hand")]


@pytest.mark.parametrize(
    ("settings", "refusal"),
    [
        ({"task": STOVE}, f"says '{BOWL}' of demo_0"),
        ({"fps": 10.0}, "fps=10, but .* says 20 frames per second"),
    ],
)
def test_settings_that_contradict_the_file_are_refused_unless_overruled(
    tmp_path: Path, settings: dict, refusal: str, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_libero(tmp_path / "x_demo.hdf5")
    with pytest.raises(ConfigError, match=refusal) as refused:
        imported(Source(path), tmp_path, **settings)
    assert "--overrule=true" in str(refused.value) and not (tmp_path / ".dataset.import").exists()
    root = imported(Source(path), tmp_path, **settings, overrule=True)
    record = read_collection(root)
    assert record["overruled"] and "overruled" in caplog.text
    assert {"task": record["task"], "fps": record["fps"]}.items() >= settings.items()
    imported(Source(path), tmp_path / "same", task=f"  {BOWL.title()} ", fps=20.0)  # says the same


def test_what_nobody_says_has_to_be_given(tmp_path: Path) -> None:
    path = write_robomimic(tmp_path / "low_dim.hdf5")
    with h5py.File(path, "r+") as file:
        del file["data"].attrs["env_args"]
    with pytest.raises(ConfigError, match=r"does not say at which rate.*--fps"):
        imported(Source(path), tmp_path, task="lift")
    with pytest.raises(ConfigError, match=r"does not say what demo_0 does, nor 1 more.*--task"):
        imported(Source(path), tmp_path, fps=20)


@pytest.mark.parametrize(("given", "kept"), [(20.0, "20"), (29.97, "29.97"), (12.5, "12.5")])
def test_rates_are_kept_exactly(tmp_path: Path, given: float, kept: str) -> None:
    path = write_robomimic(tmp_path / "image.hdf5", images=("agentview_image", "robot0_eye_in_hand_image"))
    root = imported(Source(path), tmp_path, fps=given, overrule=True, video=True)
    assert f'"fps": {kept},' in (root / "meta/info.json").read_text()
    table = read_table(root, ["timestamp"])
    assert np.allclose(table.columns["timestamp"][:T], np.arange(T) / given, atol=1e-4)


@pytest.mark.parametrize(
    ("attribute", "value", "refusal"),
    [
        ("env_args", "{no json", "attribute 'env_args' of /data is no JSON"),
        ("env_args", json.dumps({"env_kwargs": {"control_freq": "fast"}}), "control_freq='fast' is no rate"),
        ("env_args", json.dumps({"env_kwargs": {"control_freq": 0}}), "control_freq=0 is no rate"),
    ],
)
def test_damaged_attributes_are_named(tmp_path: Path, attribute: str, value: str, refusal: str) -> None:
    path = write_robomimic(tmp_path / "low_dim.hdf5")
    with h5py.File(path, "r+") as file:
        file["data"].attrs[attribute] = value
    with pytest.raises(DatasetError, match=refusal):
        imported(Source(path), tmp_path)


@pytest.mark.parametrize(
    ("array", "refusal"),
    [
        ("data", "there is no group 'data'"),
        ("data/demo_0", r"/data/demo_0 is an array of shape \(5, 7\)"),
        ("data/demo_0/obs", r"'data/demo_0/obs' is an array of shape \(5, 7\), not a group"),
        ("data/demo_0/obs/robot0_joint_pos/inner", r"lacks 1 array"),
        ("mask", "filter_key='train' selects nothing"),
        ("mask/train", "filter_key='train' selects nothing"),
    ],
)
def test_an_array_where_a_group_is_expected_is_told(tmp_path: Path, array: str, refusal: str) -> None:
    """And a group where an array is: the message itself must not fail."""
    path = write_robomimic(tmp_path / "low_dim.hdf5")
    with h5py.File(path, "r+") as file:
        parent = array.removesuffix("/inner")
        if parent in file:
            del file[parent]
        file[array] = np.zeros((5, 7))
    with pytest.raises(DatasetError, match=refusal):
        imported(Source(path, filter_key="train" if "mask" in array else None), tmp_path)


def test_tiny_video_is_refused_before_anything_is_staged(tmp_path: Path) -> None:
    path = tmp_path / "tiny.hdf5"
    write_robomimic(path, images=("agentview_image", "robot0_eye_in_hand_image"))
    with h5py.File(path, "r+") as file:
        for number in range(2):
            del file[f"data/demo_{number}/obs/agentview_image"]
            file[f"data/demo_{number}/obs/agentview_image"] = np.zeros((T, 16, 24, 3), dtype=np.uint8)
    with pytest.raises(BudsError, match=r"'observation.images.agentview' is 24 x 16 pixels.*--video=false"):
        imported(Source(path), tmp_path / "out", video=True)
    assert not (tmp_path / "out").exists()
    imported(Source(path), tmp_path)  # as images they are good
