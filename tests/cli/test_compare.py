"""``lerobot-buds-compare`` on small scripted demonstrations, and its refusals."""

import sys
import warnings

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset, add_features
from matplotlib.image import imread

from lerobot_buds.cli import compare
from lerobot_buds.cli.compare import GRIP_AND_REST, CompareConfig, _methods
from lerobot_buds.core import ConfigError, read_json
from lerobot_buds.data import Origin
from lerobot_buds.evaluation import METHODS

SMALL = [
    *("--seeds=2", "--representation.image_size=32", "--representation.steps=5", "--representation.batch_size=16"),
    *("--representation.device=cpu", "--discovery.max_skills=3"),
]


def run(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-compare", *map(str, arguments)])
    compare.main()


def test_all_methods_are_compared_on_every_seed(demonstrations, tmp_path, monkeypatch, capsys):
    run(monkeypatch, "--repo_id=tests/demos", f"--root={demonstrations}", f"--work_dir={tmp_path}", *SMALL)
    rows = read_json(tmp_path / "comparison.json")
    assert [row["method"] for row in rows] == list(METHODS)
    assert all(row["seeds"] == [0, 1] for row in rows)
    assert all(row["dataset"]["content"] == Origin.of(demonstrations).content for row in rows)
    (oracle,) = [row for row in rows if row["method"] == "true stages"]
    assert oracle["boundary F1"]["low"] == 1
    assert imread(tmp_path / "comparison.png").std() > 0.1
    assert capsys.readouterr().out.count("\n| ") == 2 * len(METHODS) + 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--seeds=0"], "seeds=0 cannot work"),
        (["--gripper=[hand*]"], "gripper: 'hand*' matches no dimension of the state."),
        (["--methods=[uniformly]"], "Did you mean 'uniform'"),
    ],
)
def test_what_cannot_work_ends_in_one_line(demonstrations, tmp_path, monkeypatch, arguments, said):
    with pytest.raises(SystemExit) as stop:
        run(
            monkeypatch,
            *("--repo_id=tests/demos", f"--root={demonstrations}", f"--work_dir={tmp_path}", *SMALL, *arguments),
        )
    assert said in str(stop.value.code) and "\n" not in str(stop.value.code)


def test_hand_and_gripper_of_somebody_elses_robot_are_not_guessed(caplog):
    config = CompareConfig("tests/any")
    assert GRIP_AND_REST in _methods(config, with_signals=True)
    assert not caplog.text
    assert set(METHODS) - set(_methods(config, with_signals=False)) == {GRIP_AND_REST}
    assert "needs --position and --gripper" in caplog.text and "left out" in caplog.text
    with pytest.raises(ConfigError, match="needs --position and --gripper"):
        _methods(CompareConfig("tests/any", methods=[GRIP_AND_REST]), with_signals=False)


def test_a_robot_with_other_names_is_told_how_to_say_them(make_dataset, tmp_path, monkeypatch, capsys):
    stages = {"names": ["x", "claw"], "shape": (2,)}
    root = make_dataset(tmp_path / "source", lengths=(40, 30), state=stages)
    dataset = add_features(
        LeRobotDataset("tests/foreign", root=root),
        {"true_stage": (np.repeat([0, 1, 0, 1], [20, 20, 15, 15]), {"dtype": "int64", "shape": (1,), "names": None})},
        output_dir=tmp_path / "staged",
        repo_id="tests/staged",
    )
    arguments = ["--repo_id=tests/staged", f"--root={dataset.root}", f"--work_dir={tmp_path / 'work'}", *SMALL]
    arguments += ["--representation.image_size=16", "--methods=[grip and rest, true stages]"]
    with pytest.raises(SystemExit) as stop:
        run(monkeypatch, *arguments)
    assert "needs --position and --gripper" in str(stop.value.code) and not (tmp_path / "work").exists()
    with warnings.catch_warnings(action="error", category=RuntimeWarning):  # the mean of no finger
        run(monkeypatch, *arguments, "--position=[x]", "--gripper=[]")
    assert "| grip and rest |" in capsys.readouterr().out
