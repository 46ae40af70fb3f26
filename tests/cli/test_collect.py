"""``lerobot-buds-collect``: its arguments, and one line for what goes wrong."""

import subprocess
import sys
from pathlib import Path

import draccus
import pytest
from matplotlib.image import imread

from lerobot_buds.cli import collect

pytestmark = pytest.mark.slow

CHECKOUT = Path(__file__).parents[2]


def test_arguments_become_settings():
    config = draccus.parse(
        collect.CollectConfig, args=["--repo_id=me/demos", "--episodes=3", "--video=false", "--root=there", "--seed=5"]
    )
    assert config == collect.CollectConfig("me/demos", episodes=3, video=False, root=Path("there"), seed=5)
    assert config.task == "multitask_kitchen/task3_variant1" and config.render_profile == "fast"
    assert (config.manner, config.clean_actions) == ("scripted", False)
    config = draccus.parse(collect.CollectConfig, args=["--manner=people", "--clean_actions=true"])
    assert (config.manner, config.clean_actions) == ("people", True)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--task=multitask_kitchen/task3_varient1"], "Did you mean 'multitask_kitchen/task3_variant1'"),
        (["--render_profile=pretty"], "There is no render profile 'pretty'"),
        (["--manner=peple"], "There is no manner 'peple'. Did you mean 'people'"),
        (["--episodes=0"], "episodes=0 cannot work"),
        (["--episodes=many"], "Couldn't parse 'many' into an int"),
        (["--seed=100000"], "Seeds from 100000 on are for evaluation"),
        (["--image_size=16"], "is 16 x 16 pixels, but video has at least 32"),
        (["--repo_id="], "The dataset has no name"),
        (["--task=tool_use/full,Lift"], "no demonstrator for robosuite's own tasks: Lift"),
    ],
)
def test_what_cannot_work_ends_in_one_line(arguments, said, monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-collect", "--repo_id=a/b", f"--root={tmp_path}/d", *arguments])
    with pytest.raises(SystemExit) as stop:
        collect.main()
    message = stop.value.code
    assert isinstance(message, str)  # Python prints it and exits with status 1
    assert message.startswith("error: ") and said in message and "\n" not in message
    assert list(tmp_path.iterdir()) == []


def test_a_preview_is_one_sheet_a_task_and_records_nothing(monkeypatch, tmp_path, capsys):
    tasks = ("tool_use/cube_fetched", "multitask_kitchen/task3_variant1")
    arguments = [f"--task={','.join(tasks)}", f"--preview={tmp_path}/sheets", "--image_size=16"]
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-collect", *arguments, "--render_profile=fastest"])
    collect.main()
    sheets = [tmp_path / "sheets" / f"{task.replace('/', '.')}.png" for task in tasks]
    assert capsys.readouterr().out.split() == [str(sheet) for sheet in sheets]
    # A row a stage, four frames of each of the two cameras in it.
    assert all(imread(sheet).shape[:2] == (396, 1452) and imread(sheet).std() > 0.1 for sheet in sheets)
    assert [path.name for path in tmp_path.iterdir()] == ["sheets"]


def test_the_status_is_1_without_a_traceback(tmp_path):
    script = "from lerobot_buds.cli.collect import main; main()"
    arguments = ["--repo_id=a/b", f"--root={tmp_path}"]  # exists already
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments], cwd=CHECKOUT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1 and done.stdout == ""
    assert done.stderr == f"error: {tmp_path} exists already. Remove it or choose another --root.\n"
