"""What LeRobot hands over is read as what it is: ranks, types, tasks, names of cameras."""

import json

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDataset
from lerobot.policies import make_policy, make_pre_post_processors
from lerobot.scripts import lerobot_train

from lerobot_buds.core import ACTION, EYE_IN_HAND_CAMERA, STATE, WORKSPACE_CAMERA, CheckpointError, ConfigError
from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.inputs import read_actions, read_inputs
from lerobot_buds.policy.modeling_buds import BudsPolicy

pytestmark = pytest.mark.slow


@pytest.fixture
def robot(record_robot, small, tmp_path):
    """Records a robot of given sizes and types; returns a policy on it and its batch of the first episode."""

    def robot(states, actions, **settings):
        meta = record_robot(tmp_path / "data", states, actions)
        config = BudsConfig(**{**small, "current_state": None, "history_state": None, **settings})
        policy = make_policy(config, ds_meta=meta)
        deltas = {ACTION: [i / meta.fps for i in policy.config.action_delta_indices or []]}
        dataset = LeRobotDataset("tests/robot", root=meta.root, delta_timestamps=deltas if deltas[ACTION] else None)
        rows = [dataset[row] for row in range(len(states[0]))]
        prepare, _ = make_pre_post_processors(config, dataset_stats=meta.stats)
        return policy, prepare(torch.utils.data.default_collate(rows))

    return robot


@pytest.mark.parametrize("chunk", [1, 3])
@pytest.mark.parametrize(("state", "action"), [(1, 2), (2, 1), (1, 1)])
def test_one_number_is_a_vector_of_one(robot, chunk, state, action):
    ramp = np.linspace(-1, 1, 12, dtype=np.float32)[:, None]
    policy, batch = robot([ramp.repeat(state, 1)], [0.5 * ramp.repeat(action, 1)], skills="single", chunk_size=chunk)
    if action == 1:
        assert batch[ACTION].shape == ((1, 12) if chunk == 1 else (12, 3))  # what LeRobot makes of it
    assert read_inputs(policy.config, batch).state.shape == (12, state)
    wanted = read_actions(policy.config, batch)
    assert wanted.shape == (12, chunk, action)
    torch.testing.assert_close(wanted[:, 0, 0], torch.from_numpy(0.5 * ramp[:, 0]))
    loss = policy(batch, reduction="none")[0]
    assert loss.shape == (12,)
    if chunk == 1:
        flat = {**batch, ACTION: wanted[:, 0, 0] if action == 1 else batch[ACTION]}
        assert torch.equal(read_actions(policy.config, flat), wanted)  # before its processor
    shown = {key: value for key, value in batch.items() if key.startswith("observation")}
    assert policy.select_action(shown).shape == (12, action)
    policy.reset()
    assert policy.predict_action_chunk(shown).shape == (12, chunk, action)


def test_one_action_is_trained_against_its_own_frame(robot):
    """The state tells the action; trained against all actions of its batch, every sample would learn their mean."""
    ramp = np.linspace(-1, 1, 40, dtype=np.float32)[:, None]
    policy, batch = robot([ramp], [0.8 * ramp], skills="flat", optimizer_lr=1e-2, crop_padding=0)
    policy.train()
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    for _ in range(150):
        loss, metrics = policy(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert metrics["action_error"] < 0.05


@pytest.mark.parametrize("dtype", ["bool", "uint8", "int64", "float16", "float64"])
@pytest.mark.parametrize("column", ["state", "action"])
def test_columns_of_any_type_are_numbers(robot, dtype, column):
    plain = np.random.default_rng(0).normal(size=(12, 2)).astype(np.float32)
    values = np.arange(24).reshape(12, 2) % 5
    typed = (values > 2 if dtype == "bool" else values).astype(dtype)
    states, actions = (typed, plain) if column == "state" else (plain, typed)
    policy, batch = robot([states], [actions], skills="single", history_state=["1"])
    loss, _ = policy(batch)
    loss.backward()
    assert loss.dtype == torch.float32 and loss.isfinite()
    action = policy.select_action({key: value for key, value in batch.items() if key.startswith("observation")})
    assert action.dtype == torch.float32 and action.isfinite().all()
    assert action.min() > float(actions.min()) - 1 and action.max() < float(actions.max()) + 1


def test_shapes_are_compared_before_anything_broadcasts(build, batch_of):
    policy, batch = build(), batch_of(0, 1, 2)
    with pytest.raises(CheckpointError, match=r"1 action\(s\) of 4 number\(s\).*\(3, 1\)"):
        policy({**batch, ACTION: batch[ACTION][:, :1]})
    with pytest.raises(CheckpointError, match=r"3 action\(s\) of 4.*\(3, 4\)"):
        build(chunk_size=3)(batch)
    with pytest.raises(CheckpointError, match=r"observation.state.*\(5,\).*\(1,\)"):
        policy({**batch, STATE: batch[STATE][:, :1]})
    with pytest.raises(CheckpointError, match=r"observation.state has 2 rows.*have 3"):
        policy({**batch, STATE: batch[STATE][:2]})
    with pytest.raises(CheckpointError, match="no 'action'"):
        policy({key: value for key, value in batch.items() if key != ACTION})


def test_images_of_bytes_are_the_same_images(build, batch_of):
    policy, batch = build(), batch_of(0, 12)
    images = {key: (255 * value).round().byte() for key, value in batch.items() if key in policy.config.image_features}
    expected = read_inputs(policy.config, batch).images
    torch.testing.assert_close(read_inputs(policy.config, {**batch, **images}).images, expected)


def test_a_task_given_alone_is_the_task_of_all_rows(build, batch_of, task):
    policy = build(tasks=[task, "Boil the pot"])
    batch = {key: value for key, value in batch_of(0, 12).items() if key.startswith("observation")}
    assert read_inputs(policy.config, {**batch, "task": "Boil the pot"}).task.tolist() == [1, 1]
    assert read_inputs(policy.config, {**batch, "task": ["Boil the pot", task]}).task.tolist() == [1, 0]
    with pytest.raises(ConfigError, match="'Boil the pott'"):
        policy.select_action({**batch, "task": "Boil the pott"})
    with pytest.raises(CheckpointError, match=r"1 tasks for 2 rows"):
        policy.select_action({**batch, "task": [task]})


def test_what_is_not_used_is_said(build, caplog):
    with caplog.at_level("INFO", logger="lerobot_buds"):
        policy = build(cameras=[EYE_IN_HAND_CAMERA])
    assert policy.config.workspace_camera == EYE_IN_HAND_CAMERA
    assert f"does not use ['{WORKSPACE_CAMERA}']" in caplog.text
    assert "do not read ['eef_x.pos']" in caplog.text


@pytest.fixture
def renamed(record_robot, tmp_path):
    """Records the same robot with other names, and sizes, of its cameras."""

    def renamed(name, *cameras, pixels=32):
        rng = np.random.default_rng(0)
        states, actions = rng.normal(size=(2, 10, 3)).astype(np.float32)
        shapes = {f"observation.images.{camera}": (pixels, pixels, 3) for camera in cameras}
        return record_robot(tmp_path / name, [states], [actions], cameras=shapes)

    return renamed


def test_cameras_of_other_names_are_accepted_with_a_rename_map(renamed, small, command, run_script, tmp_path):
    open_state = {"current_state": None, "history_state": None, "skills": "flat"}
    policy = make_policy(BudsConfig(**{**small, **open_state}), ds_meta=renamed("a", "agentview", "wrist"))
    policy.save_pretrained(tmp_path / "policy")
    other = renamed("b", "front", "hand", "top")
    names = {"observation.images.front": WORKSPACE_CAMERA, "observation.images.hand": "observation.images.wrist"}
    prepared = tmp_path / "policy"
    for processor in make_pre_post_processors(policy.config, dataset_stats=other.stats):
        processor.save_pretrained(prepared)
    arguments = [a for a in command(other.root, steps=2, batch_size=4, save_checkpoint="false") if "policy" not in a]
    run_script(
        lerobot_train.main,
        *arguments,
        f"--policy.path={prepared}",
        "--policy.push_to_hub=false",
        f"--rename_map={json.dumps(names)}",
        f"--output_dir={tmp_path / 'run'}",
    )


@pytest.mark.parametrize(
    ("cameras", "pixels", "message"),
    [
        (["front"], 32, "observation.images.agentview.*observation.images.wrist.*lacks"),  # one for two
        (["agentview"], 32, r"needs \['observation.images.wrist'\].*lacks"),
        (["front", "hand"], 48, "observation.images.agentview.*lacks"),  # of another shape
    ],
)
def test_cameras_that_cannot_be_renamed_are_refused_with_both_sides(renamed, small, tmp_path, cameras, pixels, message):
    open_state = {"current_state": None, "history_state": None, "skills": "flat"}
    policy = make_policy(BudsConfig(**{**small, **open_state}), ds_meta=renamed("a", "agentview", "wrist"))
    policy.save_pretrained(tmp_path / "policy")
    other = renamed("b", *cameras, pixels=pixels)
    with pytest.raises(CheckpointError, match=message):
        BudsPolicy.from_pretrained(tmp_path / "policy", dataset_meta=other)
