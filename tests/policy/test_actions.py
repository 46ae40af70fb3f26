"""Actions of any unit and type: scaled inside the policy, exact at the bounds, kept with the weights."""

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets import LeRobotDataset
from lerobot.policies import make_policy, make_pre_post_processors
from safetensors.torch import load_file

from lerobot_buds.core import ACTION, OUR_ACTION, OUR_STATE, ConfigError, DatasetError
from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.actions import REACH, ActionCoding, ActionRange, choose_coding
from lerobot_buds.policy.modeling_buds import BudsPolicy

pytestmark = pytest.mark.slow

DEGREES = ["pan", "lift", "gripper"]


def found(low, high, binary=(), outliers=(), names=DEGREES):
    low, high = (np.array(bound, dtype=np.float32) for bound in (low, high))
    return ActionRange(list(names), low, high, list(binary), list(outliers))


def coding(actions, **settings):
    size = len(actions.names)
    config = BudsConfig(
        device="cpu", output_features={ACTION: PolicyFeature(type=FeatureType.ACTION, shape=(size,))}, **settings
    )
    choose_coding(config, actions)
    return ActionCoding(config, actions)


def output_for(coding, actions):
    """The outputs of the skills that are these actions, found as training would: by the gradient of the loss."""
    output = torch.zeros_like(actions, requires_grad=True)
    optimizer = torch.optim.Adam([output], lr=0.1)
    for _ in range(400):
        loss = coding.errors(output, actions).sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return output.detach()


def test_every_recorded_action_can_be_learnt_and_said():
    low, high = [-180.0, 30.0, 0.0], [175.0, 30.0, 100.0]
    code = coding(found(low, high, binary=[2]))
    wanted = torch.tensor([low, high, [12.5, 30.0, 100.0]])
    said = code.decode(code.expected(output_for(code, wanted)))
    torch.testing.assert_close(said[:, 0], wanted[:, 0], rtol=0, atol=0.02)
    assert torch.equal(said[:, 1:], wanted[:, 1:])  # constant, and one of two values: exactly


def test_nothing_is_said_far_beyond_the_bounds():
    code = coding(found([-180.0, 30.0, 0.0], [180.0, 30.0, 100.0], binary=[2]))
    said = code.decode(code.expected(torch.tensor([[1e4] * 3, [-1e4] * 3])))
    torch.testing.assert_close(said, torch.tensor([[180 / REACH, 30.0, 100.0], [-180 / REACH, 30.0, 0.0]]))


def test_errors_weigh_all_units_alike():
    code = coding(found([-180.0, 0.0, 0.0], [180.0, 0.02, 100.0]))
    zero = torch.zeros(3)
    by_dimension = [code.errors(zero, torch.tensor(wanted)) for wanted in ([180.0, 0.01, 50.0], [0.0, 0.02, 50.0])]
    torch.testing.assert_close(by_dimension, [torch.tensor(REACH**2)] * 2)
    torch.testing.assert_close(code.misses(zero, torch.tensor([90.0, 0.01, 50.0])), torch.tensor(30.0))


@pytest.mark.parametrize("dtype", ["bool", "uint8", "int64", "float32"])
def test_two_values_are_recognised_in_any_type(record_robot, tmp_path, dtype, caplog):
    told = np.tile([[0, 0], [1, 1], [1, 1], [0, 0]], (3, 1)).astype(dtype)
    meta = record_robot(tmp_path / "data", [np.ones((12, 2), np.float32)], [told], action_names=["open", "vacuum"])
    with caplog.at_level("INFO", logger="lerobot_buds"):
        policy = make_policy(BudsConfig(device="cpu", skills="flat", encoder="conv"), ds_meta=meta)
    assert policy.config.binary_dims == [0, 1]
    assert "'open' (0 to 1), 'vacuum' (0 to 1)" in caplog.text
    prepare, _ = make_pre_post_processors(policy.config, dataset_stats=meta.stats)
    dataset = LeRobotDataset("tests/robot", root=meta.root)
    batch = prepare(torch.utils.data.default_collate([dataset[i] for i in range(4)]))
    loss, metrics = policy(batch)
    loss.backward()
    assert np.isfinite(loss.item()) and metrics["action_error"] <= 1
    said = policy.select_action({k: v for k, v in batch.items() if k.startswith("observation")})
    assert said.dtype == torch.float32 and set(said.flatten().tolist()) <= {0.0, 1.0}


def test_values_that_come_once_are_no_choice(record_robot, tmp_path):
    told = np.array([[0, 0.5], [1, 0.7], [1, 0.5], [0, 0.9]], np.float32)
    meta = record_robot(tmp_path / "short", [np.ones((2, 2), np.float32)], [told[:2]])
    assert ActionRange.read(meta.root).binary == []
    meta = record_robot(tmp_path / "long", [np.ones((4, 2), np.float32)], [told])
    assert ActionRange.read(meta.root).binary == [0]


def test_outliers_do_not_squeeze_the_others(record_robot, tmp_path, caplog):
    told = np.linspace(-30, 30, 1200, dtype=np.float32)[:, None].repeat(2, axis=1)
    told[700, 1] = 4000
    parts = np.split(told, 2)
    cameras = {"observation.images.front": (4, 4, 3)}
    meta = record_robot(tmp_path / "data", parts, parts, action_names=["pan", "lift"], cameras=cameras)
    actions = ActionRange.read(meta.root)
    assert actions.outliers == [1] and abs(actions.high[1] - 30) < 0.1
    with caplog.at_level("WARNING", logger="lerobot_buds"):
        code = coding(actions)
    assert "'lift'" in caplog.text and "'pan'" not in caplog.text
    assert code.errors(torch.zeros(2), torch.tensor([0.0, 4000.0])) < 1.5


def test_actions_that_are_not_finite_are_refused(record_robot, tmp_path):
    told = np.zeros((5, 2), np.float32)
    told[3, 1] = np.nan
    meta = record_robot(tmp_path / "data", [np.ones((5, 2), np.float32)], [told], action_names=["pan", "lift"])
    with pytest.raises(DatasetError, match=r"episode 0, frame 3, dimension 1 \('lift'\)"):
        ActionRange.read(meta.root)


@pytest.mark.parametrize("names", [OUR_ACTION, ("delta_x", "delta_y", "delta_z", "gripper")], ids=["now", "before"])
def test_recordings_of_our_own_keep_the_papers_head(names):
    ours = found([-0.7] * 3 + [-1.0], [0.7] * 3 + [1.0], binary=[3], names=names)
    assert not coding(ours, state_names=list(OUR_STATE)).state_dict()
    code = coding(ours, state_names=list(OUR_STATE))
    output = torch.randn(5, 4)
    assert torch.equal(code.decode(code.expected(output)), torch.tanh(output))
    assert set(coding(ours).state_dict()) == {"low", "high"}  # another state: somebody else's robot
    degrees = found([-70.0] * 4, [70.0] * 4, names=names)
    assert set(coding(degrees, state_names=list(OUR_STATE)).state_dict()) == {"low", "high"}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"action_scaling": "none"}, r"in \[-1, 1\].*'pan' \(-180 to 180\)"),
        ({"binary_dims": [0]}, r"'pan' \(-180 to 180\) take more than two values"),
        ({"binary_dims": [3]}, r"\[3\] do not exist, the action has 3"),
    ],
)
def test_settings_that_do_not_fit_the_actions_are_refused(settings, message):
    with pytest.raises(ConfigError, match=message):
        coding(found([-180.0, -1.0, 0.0], [180.0, 1.0, 1.0], binary=[2]), **settings)


def actions_of(policy, dataset, rows):
    policy.eval()
    said = []
    for row in rows:
        policy.reset()
        shown = {key: value[None] for key, value in dataset[row].items() if key.startswith("observation")}
        said.append(policy.select_action(shown)[0].numpy())
    return np.array(said)


def test_an_arm_in_degrees_is_learnt(so101, so101_policy):
    dataset = LeRobotDataset("tests/robot", root=so101.root)
    rows = range(0, len(dataset), 3)
    told = np.array([dataset[row][ACTION].numpy() for row in rows])
    said = actions_of(BudsPolicy.from_pretrained(so101_policy), dataset, rows)
    spread = so101.stats[ACTION]["max"] - so101.stats[ACTION]["min"]
    assert (np.abs(said - told).max(axis=0) <= 0.05 * spread).all()
    assert np.array_equal(said[:, 5], told[:, 5])  # 0 or 100


def test_without_scaling_a_checkpoint_holds_no_bounds_and_actions_are_those_of_tanh(build, batch_of, tmp_path):
    build(action_scaling="none", binary_dims=[]).save_pretrained(tmp_path)
    assert not [name for name in load_file(tmp_path / "model.safetensors") if name.startswith("model.actions")]
    outputs = []
    policy = BudsPolicy.from_pretrained(tmp_path)
    policy.model.skills.register_forward_hook(lambda _, __, output: outputs.append(output))
    action = policy.select_action({k: v for k, v in batch_of(0, 12).items() if k.startswith("observation")})
    assert torch.equal(action, torch.tanh(torch.cat(outputs))[:, 0])


def test_a_checkpoint_keeps_its_scaling_on_other_data(so101, so101_policy, record_robot, tmp_path, caplog, small):
    dataset = LeRobotDataset("tests/robot", root=so101.root)
    states = [np.array([dataset[row]["observation.state"].numpy() for row in range(30)])]
    told = [np.array([dataset[row][ACTION].numpy() for row in range(30)])]
    told[0][:, 1] *= 10
    names = so101.features[ACTION]["names"]
    cameras = {key: so101.features[key]["shape"] for key in so101.camera_keys}
    other = record_robot(tmp_path / "data", states, told, names, names, cameras, task="Pick")
    source = BudsPolicy.from_pretrained(so101_policy)
    config = BudsConfig.from_pretrained(so101_policy)
    config.pretrained_path = so101_policy
    with caplog.at_level("WARNING", logger="lerobot_buds"):
        tuned = make_policy(config, ds_meta=other)
    assert torch.equal(tuned.model.actions.low, source.model.actions.low)
    assert torch.equal(tuned.model.actions.high, source.model.actions.high)
    assert "cannot reach all of 'shoulder_lift.pos'" in caplog.text
    caplog.clear()
    assert np.array_equal(actions_of(tuned, dataset, [7]), actions_of(source, dataset, [7]))
    make_policy(config, ds_meta=so101)
    assert not caplog.text


@pytest.mark.parametrize("scaling", ["bounds", "none"])
def test_skills_of_a_library_keep_its_scaling(build, tmp_path, scaling):
    library = build(action_scaling=scaling, binary_dims=[])
    with torch.no_grad():  # as if from other data
        library.model.actions.high *= 3
    library.save_pretrained(tmp_path)
    policy = build(skills_path=str(tmp_path))
    assert policy.config.action_scaling == scaling
    said = torch.tensor([-1.0, -0.5, 0.3, 1.0])
    decoded = policy.model.actions.decode(said)
    assert torch.equal(decoded, library.model.actions.decode(said))
    assert torch.equal(decoded, said) is (scaling == "none")


@pytest.mark.parametrize("skills", ["segments", "single", "flat"])
@pytest.mark.parametrize("chunk", [1, 3])
def test_all_kinds_of_skills_say_actions_in_their_unit(build, batch_of, monkeypatch, skills, chunk):
    policy = build(skills=skills, chunk_size=chunk)
    with torch.no_grad():
        policy.model.actions.low.fill_(100.0)
        policy.model.actions.high.fill_(140.0)
    batch = batch_of(*range(8))
    if chunk > 1:
        batch[ACTION] = batch[ACTION][:, None].repeat(1, chunk, 1)
    batch[ACTION] = 120 + 10 * batch[ACTION]
    metrics = policy(batch)[1]
    assert metrics["skill_loss"] < 4 and 0.1 < metrics["action_error"] < 30
    for _ in range(3):
        said = policy.select_action({k: v for k, v in batch.items() if k.startswith("observation")})
        assert said.min() > 97 and said.max() < 143
