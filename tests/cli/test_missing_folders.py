"""Whatever a command is to read: where it is not there, the command says so in one line, and asks no Hub for it."""

import importlib
import sys
from pathlib import Path

import httpx
import pytest

HERE = {  # command -> (what it is given beside what is missing, options that name something that is to be read)
    "diagnose": ("--repo_id=me/x --root={skills}", ["--policy_path"]),
    "rollout": ("--output_dir={out}", ["--policy_path"]),
    "segment": ("--repo_id=me/x --root={demos} --output_root={out}", ["--library", "--representation_path"]),
    "share": ("--repo_id=me/x", ["--root"]),
    "report": ("--repo_id=me/x --output={out}", ["--root"]),
    "compare": ("--repo_id=me/x --work_dir={out}", ["--root"]),
    "name": ("", ["--root"]),
    "join": ("--output_root={out}", ["--root"]),
}
CASES = [(command, given, option) for command, (given, options) in HERE.items() for option in options]
CASES += [("segment", "--repo_id=me/x --output_root={out}", "--root")]


def end_of(command: str, arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> str:
    """How a command ends that cannot work; any request fails the test."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a request was made")

    monkeypatch.setattr(httpx.Client, "send", refuse)
    monkeypatch.setattr(sys, "argv", [f"lerobot-buds-{command}", *arguments])
    with pytest.raises(SystemExit) as stop:
        importlib.import_module(f"lerobot_buds.cli.{command}").main()
    return str(stop.value.code)


@pytest.mark.parametrize(("command", "given", "option"), CASES)
def test_a_folder_that_is_not_there(
    command: str,
    given: str,
    option: str,
    demonstrations: Path,
    segmented: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out, missing = tmp_path / "out", tmp_path / "gone" / "folder"
    arguments = given.format(demos=demonstrations, skills=segmented, out=out).split()
    said = end_of(command, [*arguments, f"{option}={missing}"], monkeypatch)
    assert said.startswith("error: ") and str(missing) in said and "\n" not in said
    assert "is no folder" in said or "neither a folder" in said or "does not exist" in said
    assert not out.exists()


def test_a_policy_and_no_dataset(checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """LeRobot takes the last name of a folder that is not there for a repository."""
    missing = tmp_path / "gone"
    policy = f"--policy_path={checkpoint}"
    diagnosed = end_of("diagnose", ["--repo_id=me/x", f"--root={missing}", policy], monkeypatch)
    assert diagnosed == f"error: {missing} is no LeRobotDataset: {missing}/meta/info.json does not exist."
    drawn = ["--env.type=robosuite", "--env.image_size=32", "--env.render_profile=fastest"]
    task = "--env.task=multitask_kitchen/task3_variant1"
    asked = [policy, f"--dataset_root={missing}", f"--output_dir={tmp_path / 'out'}", task, *drawn]
    assert f"{missing} is no folder on this machine" in end_of("rollout", asked, monkeypatch)


def test_in_python_a_folder_may_be_a_path(segmented: Path, checkpoint: Path, tmp_path: Path) -> None:
    from lerobot_buds.core import CheckpointError, DatasetError
    from lerobot_buds.evaluation.checkpoint import load_policy

    with pytest.raises(CheckpointError, match="neither a folder on this machine"):
        load_policy(tmp_path / "gone", segmented)  # type: ignore[arg-type]
    with pytest.raises(DatasetError, match="is no LeRobotDataset"):
        load_policy(str(checkpoint), tmp_path / "gone")
