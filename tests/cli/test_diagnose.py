"""``lerobot-buds-diagnose`` on a small segmented dataset: figures, a table, and refusals."""

import json
import sys

import pytest
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy

from lerobot_buds.cli import diagnose
from lerobot_buds.cli.segment import segment
from lerobot_buds.core import ConfigError
from lerobot_buds.policy import BudsConfig

SMALL = {
    "encoder": "conv",
    "norm": "group",
    "conv_channels": [8, 8],
    "keypoints": 4,
    "head_widths": [8],
    "meta_latent": 4,
    "meta_encoder_widths": [8],
    "meta_head_widths": [8],
    "shared_trunk": True,
    "device": "cpu",
}


@pytest.fixture
def options(make_dataset, settings, tmp_path, monkeypatch):
    """Makes a checkpoint of an untrained policy for a segmented dataset, and the command's arguments for both."""
    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path / "home"))
    segment(settings(make_dataset(tmp_path / "source"), tmp_path))
    root = tmp_path / "skills"

    def options(**changes):
        policy = make_policy(BudsConfig(**SMALL | changes), ds_meta=LeRobotDatasetMetadata("tests/foreign", root=root))
        policy.save_pretrained(tmp_path / "policy")
        return [f"--policy_path={tmp_path / 'policy'}", "--repo_id=tests/foreign", f"--root={root}"]

    return options


@pytest.mark.parametrize("space", ["latent", "image"])
def test_it_tells_who_errs_by_how_much(options, tmp_path, monkeypatch, capsys, space):
    file = tmp_path / "figures.json"
    arguments = [*options(subgoal_space=space), "--episodes=[1]", f"--output={file}"]
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-diagnose", *arguments])
    diagnose.main()
    figures = json.loads(file.read_text())
    assert figures["frames"] == 25  # those of the chosen episode
    assert set(figures["errors"]) == {"chosen", "imagined", "held", "shuffled"}
    printed = capsys.readouterr().out
    assert f"{figures['errors']['held']:.4f}" in printed
    assert f"{figures['skill_ids']['right']:.1%} of the frames" in printed


def test_a_flat_policy_has_one_row(options, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-diagnose", *options(skills="flat")])
    diagnose.main()
    printed = capsys.readouterr().out.splitlines()  # after what LeRobot says of the weights
    assert [line.split()[0] for line in printed[-2:]] == ["squared", "chosen"] and not any(
        "held" in line for line in printed
    )


def test_a_checkpoint_must_be_named():
    with pytest.raises(ConfigError, match="policy_path is missing"):
        diagnose.diagnose_policy(diagnose.DiagnoseConfig("tests/foreign"))


def test_what_is_no_checkpoint_is_refused(options, tmp_path, monkeypatch):
    arguments = [f"--policy_path={tmp_path}", *options()[1:]]
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-diagnose", *arguments])
    with pytest.raises(SystemExit, match="is no checkpoint"):
        diagnose.main()
