"""The examples run, small, and say what they show."""

import ast
import json
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from lerobot_buds.core import SegmentationError
from lerobot_buds.segmentation import SegmentationRecord, load_labels

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("tasks_of_its_own")]

EXAMPLES = Path(__file__).parents[2] / "examples"
OWN_TASK = EXAMPLES.parent / "docs/own_task.md"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
NOTEBOOK = EXAMPLES / "1_segment.ipynb"


def run(number: int, *options: object) -> Any:
    """Runs an example with options, in this process."""
    (path,) = EXAMPLES.glob(f"{number}_*.py")
    return runpy.run_path(str(path))["main"]([str(option) for option in options])


def code_cells() -> list[str]:
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def test_they_are_numbered_short_and_listed() -> None:
    assert [int(path.name.split("_")[0]) for path in SCRIPTS] == list(range(1, len(SCRIPTS) + 1))
    assert all(len(path.read_text().splitlines()) <= 90 for path in SCRIPTS)
    listed = re.findall(r"^\| \[([^]]*)\]", (EXAMPLES / "README.md").read_text(), flags=re.M)
    assert sorted(listed) == sorted(path.name for path in [*SCRIPTS, NOTEBOOK])


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_what_an_example_says_to_type_is_understood(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The options of the calls at its top are those that its help lists."""
    namespace = runpy.run_path(str(path))
    calls = re.findall(rf"^    python examples/{path.name} (.*)$", namespace["__doc__"], flags=re.M)
    with pytest.raises(SystemExit):
        namespace["main"](["--help"])
    known = set(re.findall(r"^  (--\w+)", capsys.readouterr().out, flags=re.M))
    assert calls
    assert {option for call in calls for option in re.findall(r"(?<= )--\w+", f" {call}")} <= known


def test_segment_your_dataset(demonstrations: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "skills"
    options = ["--repo_id=tests/demos", f"--root={demonstrations}", f"--output_root={output}"]
    found = run(1, *options, "--image_size=32", "--steps=5")
    printed = capsys.readouterr().out
    assert found == SegmentationRecord.read(output)
    assert f"{found.n_skills} skills in 4 demonstrations" in printed
    assert printed.count("  demonstration 0") == len(found.episodes[0].segments)
    assert Path(re.findall(r"timelines: (\S+);", printed)[0]).is_file()
    load_labels(output)


def test_train_with_labels(segmented: Path, demonstrations: Path, capsys: pytest.CaptureFixture[str]) -> None:
    errors = run(2, f"--root={segmented}", "--steps=60")
    assert list(errors) == ["state", "state, skill and subgoal"]
    assert all(0.0 < error < 2.0 for error in errors.values())
    assert f"from state: {errors['state']:.3f}" in capsys.readouterr().out
    with pytest.raises(SegmentationError, match="no segmentation record"):
        run(2, f"--root={demonstrations}")


def test_share_sends_nothing_unless_asked(segmented: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = run(3, f"--root={segmented}", "--repo_id=me/skills")
    assert {"meta/info.json", "meta/buds/segmentation.json", "meta/buds/exemplars.safetensors"} <= set(names)
    assert "Nothing was sent" in capsys.readouterr().out


def test_share_labels_alone(segmented: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = [f"--root={segmented}", "--repo_id=me/labels", "--labels_only", f"--output_root={tmp_path / 'labels'}"]
    names = run(3, *options)
    assert {"labels/labels.parquet", "meta/buds/segmentation.json", "README.md"} <= set(names)
    assert not any(name.endswith(".mp4") for name in names)
    assert f"in {tmp_path / 'labels'}" in capsys.readouterr().out


def test_look_into_a_policy(
    checkpoint: Path, segmented: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded = ["--image_size=32", "--render_profile=fastest"]
    options = [f"--policy={checkpoint}", f"--root={segmented}", f"--output_dir={tmp_path / 'look'}"]
    record = run(4, *options, *recorded, "--episodes=1", "--episode_length=6")
    printed = capsys.readouterr().out
    assert "squared action error" in printed and "right skills" in printed
    assert "seed 500000: no success, skills [" in printed and len(record.episodes) == 1
    assert (tmp_path / "look/ribbons.png").is_file()


def test_the_page_shows_the_task_that_is_written_and_makes_it_in_gymnasium() -> None:
    shown, made = re.findall(r"^```python\n(.*?)^```", OWN_TASK.read_text(), flags=re.M | re.S)
    (path,) = EXAMPLES.glob("5_*.py")
    docstring, code = re.split(r"(?<=\"\"\")\n\n", path.read_text(), maxsplit=1)
    assert shown == code and docstring.count('"""') == 2
    names = runpy.run_path(str(path))
    exec(made, names)
    assert names["observation"]["pixels"]["agentview"].shape == (64, 64, 3)
    assert names["info"]["stages_done"].tolist() == [False, False] and names["reward"] == 0


def test_write_a_task(tmp_path: Path) -> None:
    """In a process of its own, since the processes that record take the task from what it runs."""
    options = ["--episodes=1", "--workers=1", "--image_size=32", "--render_profile=fastest", "--video=false"]
    done = subprocess.run(
        [sys.executable, next(EXAMPLES.glob("5_*.py")), "--repo_id=me/cube", f"--root={tmp_path / 'cube'}", *options],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "1 demonstrations" in done.stdout and "from 1 attempts" in done.stdout
    assert "put the cube in the red region" in (tmp_path / "cube/README.md").read_text()


def test_the_notebook_is_clean_and_its_code_compiles() -> None:
    content = json.loads(NOTEBOOK.read_text())
    assert (content["nbformat"], content["metadata"]["kernelspec"]["name"]) == (4, "python3")
    code = [cell for cell in content["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
    for source in code_cells():
        compile(source, NOTEBOOK.name, "exec")


def test_the_notebook_imports_what_there_is() -> None:
    names: dict[str, Any] = {}
    imports = [node for node in ast.parse("\n".join(code_cells())).body if isinstance(node, ast.ImportFrom)]
    for node in imports:
        if str(node.module).startswith("lerobot"):
            exec(compile(ast.Module([node], []), NOTEBOOK.name, "exec"), names)
    settings = {"CollectConfig", "SegmentConfig", "RepresentationConfig"}
    assert settings <= names.keys()
    for call in (node for node in ast.walk(ast.parse("\n".join(code_cells()))) if isinstance(node, ast.Call)):
        if isinstance(call.func, ast.Name) and call.func.id in settings:
            assert {word.arg for word in call.keywords} <= names[call.func.id].__dataclass_fields__.keys()
