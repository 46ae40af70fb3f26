"""Labels join batches in LeRobot's preprocessor, which comes from code or from a checkpoint."""

import subprocess
import sys

import pytest
import torch
from lerobot.datasets import LeRobotDataset
from lerobot.policies import make_pre_post_processors

from lerobot_buds.core import DatasetError
from lerobot_buds.policy.labels import PREFIX, Labels

pytestmark = pytest.mark.slow


@pytest.fixture
def raw(dataset_root):
    """Rows of the dataset as LeRobot's loader gives them."""
    dataset = LeRobotDataset("tests/segmented", root=dataset_root)
    return lambda *rows: torch.utils.data.default_collate([dataset[row] for row in rows])


def test_a_loss_needs_labels(build, raw):
    policy = build()
    with pytest.raises(DatasetError, match=r"lacks 'labels.skill'.*preprocessor"):
        policy(raw(0, 12))


def test_labels_join_the_dataset_of_the_policy_built_last(build, raw):
    config = build().config
    prepare, _ = make_pre_post_processors(config)
    assert Labels.of(prepare(raw(5, 12))).skill.tolist() == [1, 1]
    build(skills="single")
    assert Labels.of(prepare(raw(5, 12))).skill.tolist() == [0, 0]


def test_batches_of_another_dataset_get_no_labels(build, raw):
    """A loss is refused then; with the labels of the wrong dataset it would be computed."""
    policy = build()
    prepare, _ = make_pre_post_processors(policy.config)
    batch = raw(5, 12)
    others = [{**batch, "action": batch["action"] + 1}, {**batch, "index": batch["index"] + 1000}]
    for other in others:
        assert not [key for key in prepare(other) if key.startswith(PREFIX)]
        with pytest.raises(DatasetError, match=r"lacks 'labels.skill'.*last built for"):
            policy(prepare(other))


def test_a_single_frame_gets_labels_of_one_row(build, dataset_root):
    prepare, _ = make_pre_post_processors(build().config)
    labels = Labels.of(prepare(LeRobotDataset("tests/segmented", root=dataset_root)[5]))
    assert labels.skill.tolist() == [1] and labels.history.shape == (1, 5, 2)


def test_observations_of_a_rollout_get_none(build, raw):
    prepare, _ = make_pre_post_processors(build().config)
    observation = {key: value for key, value in raw(0, 1).items() if key.startswith("observation")}
    assert not [key for key in prepare(observation) if key.startswith(PREFIX)]


def test_a_checkpoint_is_all_that_a_fresh_process_needs(build, raw, tmp_path):
    """LeRobot finds policy and pipelines through the plugin, and acts alike."""
    policy = build(chunk_size=3, n_action_steps=2)
    for part in (policy, *make_pre_post_processors(policy.config)):
        part.save_pretrained(tmp_path / "policy")
    observation = {key: value for key, value in raw(0, 12).items() if key.startswith("observation")}
    torch.save(observation, tmp_path / "observation.pt")
    expected = torch.stack([policy.select_action(observation) for _ in range(6)])
    script = (
        "import sys, torch; torch.set_num_threads(1); folder = sys.argv[1]\n"
        "from lerobot.utils.import_utils import register_third_party_plugins\n"
        "register_third_party_plugins()\n"
        "assert not {f'lerobot_buds.policy.{m}_buds' for m in ('modeling', 'processor')} & set(sys.modules)\n"
        "from lerobot.configs import PreTrainedConfig\n"
        "from lerobot.policies import get_policy_class, make_pre_post_processors\n"
        "config = PreTrainedConfig.from_pretrained(folder + '/policy')\n"
        "prepare, finish = make_pre_post_processors(config, pretrained_path=folder + '/policy')\n"
        "policy = get_policy_class(config.type).from_pretrained(folder + '/policy')\n"
        "observation = torch.load(folder + '/observation.pt', weights_only=True)\n"
        "actions = [finish(policy.select_action(prepare(observation))) for _ in range(6)]\n"
        "torch.save(torch.stack(actions), folder + '/actions.pt')\n"
    )
    subprocess.run([sys.executable, "-c", script, str(tmp_path)], check=True, timeout=300)
    assert torch.equal(torch.load(tmp_path / "actions.pt", weights_only=True), expected)
