"""robosuite's own recordings: states that are played back in a small scene of the installed robosuite."""

import json
import logging
from functools import cache
from pathlib import Path

import h5py
import mujoco
import numpy as np
import pytest
import robosuite

from lerobot_buds.core import ConfigError, DatasetError, read_json
from lerobot_buds.data import cached_frames, read_collection, read_table
from lerobot_buds.demos.hdf5 import Source, open_demonstrations
from lerobot_buds.demos.importing import Import, import_demonstrations
from lerobot_buds.envs import STATE_NAMES

pytestmark = pytest.mark.slow

T, SIZE = 6, 32
ASSETS = Path(robosuite.__file__).parent / "models" / "assets"


@cache
def lift() -> tuple[str, np.ndarray, np.ndarray]:
    """The model of Lift, T states of an arm that moves, and where its hand is in them (m)."""
    env = robosuite.make("Lift", robots="Panda", use_camera_obs=False, has_renderer=False, has_offscreen_renderer=False)
    xml, model = env.sim.model.get_xml(), env.sim.model._model
    start = env.sim.get_state().flatten()
    env.close()
    data, states, hands = mujoco.MjData(model), np.repeat(start[None], T, axis=0), []
    states[:, 0] = 0.052 + 0.05 * np.arange(T)
    states[:, 2] += 0.15 * np.arange(T)  # the second joint, so that the hand and what the eye in it sees move
    for state in states:
        data.qpos[:] = state[1 : 1 + model.nq]
        mujoco.mj_forward(model, data)
        hands.append(data.site("gripper0_right_grip_site").xpos.copy())
    return xml, states, np.array(hands)


def write(path: Path, xml: str, states: np.ndarray, **arrays: np.ndarray) -> Path:
    arrays = arrays or {"actions": np.arange(len(states) * 7.0).reshape(-1, 7)}
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env"] = "Lift"
        data.attrs["env_info"] = json.dumps({"env_name": "Lift", "robots": "Panda"})
        for number in (1, 2):
            group = data.create_group(f"demo_{number}")
            group["states"] = states
            for name, values in arrays.items():
                group[name] = values
            group.attrs["model_file"] = xml
    return path


def imported(source: Source, tmp_path: Path, **settings: object) -> Path:
    plan = Import(source, "test/played", tmp_path / "dataset", **{"video": False, **settings})
    import_demonstrations(plan, cache_dir=tmp_path / "cache")
    return plan.root


def test_states_are_played_back_and_drawn(tmp_path: Path) -> None:
    xml, states, hands = lift()
    root = imported(Source(write(tmp_path / "demo.hdf5", xml, states), image_size=SIZE), tmp_path)
    table = read_table(root, ["observation.state", "action"])
    state = table.columns["observation.state"]
    assert read_json(root / "meta/info.json")["features"]["observation.state"]["names"] == STATE_NAMES
    assert np.allclose(state[:T, :9], states[:, 1:10], atol=1e-6)
    assert np.allclose(state[:T, 9:], hands, atol=1e-6)
    assert np.array_equal(table.columns["action"][:T], np.arange(T * 7.0).reshape(T, 7))
    record = read_collection(root)
    assert (record["layout"], record["task"], record["fps"]) == ("robosuite", "Lift", 20)
    for camera in ("agentview", "eye_in_hand"):
        frames = cached_frames(root, f"observation.images.{camera}", tmp_path / "cache")
        assert frames.shape == (2 * T, 3, SIZE, SIZE)
        assert all(frames[t].std() > 10 and (frames[t] != frames[t + 1]).any() for t in range(T - 1))
        assert np.array_equal(frames[:T], frames[T:])


def test_images_are_those_of_the_scene_with_the_top_row_first(tmp_path: Path) -> None:
    xml, states, _ = lift()
    source = Source(write(tmp_path / "demo.hdf5", xml, states), cameras={"front": "frontview"}, image_size=SIZE)
    with open_demonstrations(source) as demonstrations:
        drawn = demonstrations.read("demo_1")["observation.images.front"]
        thing = demonstrations.bodies("demo_1")
    assert thing.keys() == {"cube_main"} and thing["cube_main"].shape == (T, 3)
    model = mujoco.MjModel.from_xml_string(xml)
    model.camera("frontview")  # exists
    # The robot's arm is in the upper half of the front view, the table's legs and the floor in the lower.
    moved = np.abs(drawn[-1].astype(int) - drawn[0]).sum(axis=(1, 2))
    assert moved[: SIZE // 2].sum() > moved[SIZE // 2 :].sum()


def test_models_beside_the_file_find_their_meshes_by_name(tmp_path: Path) -> None:
    """As robosuite 1.0 left them: a file name, absolute paths of another machine, and a folder that has moved since."""
    xml, states, _ = lift()
    (tmp_path / "models").mkdir()
    (tmp_path / "models/model_1.xml").write_text(xml.replace(str(ASSETS), "/Users/somebody/robosuite/models/assets"))
    path = write(tmp_path / "demo.hdf5", "model_1.xml", states)
    with open_demonstrations(Source(path, image_size=SIZE)) as demonstrations:
        here = demonstrations.read("demo_1")
    with open_demonstrations(Source(write(tmp_path / "text.hdf5", xml, states), image_size=SIZE)) as demonstrations:
        there = demonstrations.read("demo_1")
    assert all(np.array_equal(here[key], there[key]) for key in there)
    (tmp_path / "models/model_1.xml").unlink()
    with (
        pytest.raises(DatasetError, match=r"the model of demo_1 is missing \(attribute model_file='model_1.xml'"),
        open_demonstrations(Source(path)),
    ):
        pass


def test_old_spellings_and_missing_meshes(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    xml, states, _ = lift()
    shown = '<mesh name="gone_vis" file="/x/gone_vis.stl"/></asset>'
    geom = '<geom type="mesh" mesh="gone_vis" group="1" contype="0" conaffinity="0"/>'
    geom += '<site pos="[0, 0, 0.005]"/></worldbody>'
    ported = xml.replace("</asset>", shown).replace("</worldbody>", geom)
    path = write(tmp_path / "demo.hdf5", ported, states)
    caplog.set_level(logging.WARNING)
    with open_demonstrations(Source(path)) as demonstrations:
        changes = demonstrations.facts["model_changes"]
    assert any("read without brackets: 1 attributes" in change for change in changes)
    assert any("not drawn" in change and "gone_vis.stl" in change for change in changes)
    assert "gone_vis.stl" in caplog.text
    solid = ported.replace('contype="0" conaffinity="0"/><site', "/><site")
    with (
        pytest.raises(DatasetError, match=r"lacks 1 file.*gone_vis.stl.*--assets"),
        open_demonstrations(Source(write(tmp_path / "solid.hdf5", solid, states))),
    ):
        pass
    # A folder that has it comes first.
    mesh = next(ASSETS.rglob("link0.stl"))
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets/gone_vis.stl").write_bytes(mesh.read_bytes())
    with open_demonstrations(Source(path, assets=tmp_path / "assets")) as demonstrations:
        assert not any("gone_vis" in change for change in demonstrations.facts["model_changes"])


def uneven() -> np.ndarray:
    _, states, _ = lift()
    states = np.repeat(states, 3, axis=0)
    states[:, 0] = 0.01 + np.cumsum(np.tile([0.010, 0.012, 0.024], T))
    return states


def test_uneven_steps_are_never_taken_in_silence(tmp_path: Path) -> None:
    xml, states = lift()[0], uneven()
    old = {"joint_velocities": np.arange(3 * T)[:, None] * np.ones(7), "gripper_actuations": np.zeros((3 * T, 1))}
    path = write(tmp_path / "demo.hdf5", xml, states, **old)
    for settings in ({}, {"fps": 20}):
        with pytest.raises(DatasetError, match=r"0.010 to 0.024 s apart.*--resample=20.*--uneven=true"):
            imported(Source(path), tmp_path, task="lift", **settings)
    with pytest.raises(ConfigError, match="does not say at which rate"):
        imported(Source(path, uneven=True), tmp_path, task="lift")
    root = imported(Source(path, uneven=True, cameras={}), tmp_path / "all", fps=65)
    assert read_table(root, ["action"]).ends[0] == 3 * T
    with pytest.raises(ConfigError, match=r"fps=30, but .* says 25"):
        imported(Source(path, resample=25), tmp_path, fps=30)
    root = imported(Source(path, resample=25, cameras={}), tmp_path)
    taken = read_table(root, ["action"]).columns["action"]
    table = read_table(root, ["action"])
    wanted = states[0, 0] + np.arange(table.ends[0]) / 25
    nearest = np.abs(states[:, 0][None] - wanted[:, None]).argmin(axis=1)
    assert np.array_equal(taken[: table.ends[0], 0], nearest)
    record = read_collection(root)
    assert record["fps"] == 25 and record["facts"]["clock"]["resampled"] == 25
    names = read_json(root / "meta/info.json")["features"]["action"]["names"]
    assert names == [*(f"joint_velocities_{n}" for n in range(7)), "gripper_actuations_0"]


@pytest.mark.parametrize("rate", [0.0, 500.0])
def test_rows_between_states_are_not_made_up(tmp_path: Path, rate: float) -> None:
    path = write(tmp_path / "demo.hdf5", lift()[0], uneven())
    with (
        pytest.raises(ConfigError, match=f"resample={rate:g} cannot work"),
        open_demonstrations(Source(path, resample=rate)),
    ):
        pass


def test_settings_of_other_layouts_are_refused(tmp_path: Path) -> None:
    xml, states, _ = lift()
    path = write(tmp_path / "demo.hdf5", xml, states)
    for source in (Source(path, state=["robot0_eef_pos"]), Source(path, orientation="flipped")):
        with (
            pytest.raises(ConfigError, match="state and orientation are those of the simulator"),
            open_demonstrations(source),
        ):
            pass
    with pytest.raises(DatasetError, match="no cameras"), open_demonstrations(Source(path, cameras={"front": "front"})):
        pass
    with open_demonstrations(Source(path, state=[], cameras={})) as demonstrations:
        assert demonstrations.read("demo_1").keys() == {"action"}


@pytest.mark.parametrize(
    ("change", "refusal"),
    [
        (lambda states: states[:, :-1], "states of shape .* are not of its model"),
        (
            lambda states: np.where(np.arange(states.shape[1]) == 3, np.nan, states),
            "'states' is nan in demo_1, frame 0",
        ),
        (lambda states: states[:, None], "wanted are as many rows of numbers"),
    ],
)
def test_states_that_are_not_the_models_are_refused(tmp_path: Path, change: object, refusal: str) -> None:
    xml, states, _ = lift()
    path = write(tmp_path / "demo.hdf5", xml, change(states), actions=np.zeros((T, 7)))
    with pytest.raises(DatasetError, match=refusal), open_demonstrations(Source(path, cameras={})) as demonstrations:
        demonstrations.read("demo_1")


def test_a_damaged_model_is_told(tmp_path: Path) -> None:
    states = lift()[1]
    for number, (xml, refusal) in enumerate(
        (("<mujoco", "the model is damaged"), ("<mujoco><no/></mujoco>", "cannot load"))
    ):
        path = write(tmp_path / f"{number}.hdf5", xml, states)
        with pytest.raises(DatasetError, match=refusal), open_demonstrations(Source(path)):
            pass
