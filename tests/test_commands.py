"""Every command that a document names can be typed: its program exists and understands every option and value.

Nothing is run: each command's own parser reads the words, as far as the work begins.
"""

import importlib
import re
import runpy
import shlex
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import draccus
import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("examples/*.md")])
OURS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
THEIRS = {
    "lerobot-train": "lerobot.configs.train:TrainPipelineConfig",
    "lerobot-eval": "lerobot.configs.eval:EvalPipelineConfig",
    "lerobot-record": "lerobot.scripts.lerobot_record:RecordConfig",
    "lerobot-teleoperate": "lerobot.scripts.lerobot_teleoperate:TeleoperateConfig",
    "lerobot-replay": "lerobot.scripts.lerobot_replay:ReplayConfig",
    "lerobot-rollout": "lerobot.scripts.lerobot_rollout:RolloutConfig",
    "lerobot-edit-dataset": "lerobot.scripts.lerobot_edit_dataset:EditDatasetConfig",
}
STANDS_FOR = {
    "--policy.kl_weight": "1e-4",
    "--policy.decoder_sees_skill": "true",
}  # what "..." is, where no text will do
NEEDS = {
    "lerobot-train": ["--dataset.repo_id=x", "--policy.type=buds"],
    "lerobot-eval": ["--env.type=robosuite"],
    "lerobot-buds-rollout": ["--policy_path=x", "--output_dir=x", "--env.type=robosuite"],
    "lerobot-buds-share": ["--root=x", "--repo_id=x"],
    **{f"lerobot-buds-{name}": ["--repo_id=x"] for name in ("compare", "collect", "diagnose", "report", "segment")},
}
"""What a command in a sentence leaves out."""
in_blocks = runpy.run_path(str(ROOT / "scripts/run_docs.py"))["commands"]


def in_sentences(path: Path) -> list[list[str]]:
    """Commands with options in spans of code, completed by what each needs."""
    text = re.sub(r"^( *)```.*?^\1```", "", path.read_text(), flags=re.M | re.S)
    spans = re.findall(r"`((?:lerobot-buds-[a-z]+|lerobot-train|lerobot-eval|python scripts/\S+) --[^`]*)`", text)
    found = [shlex.split(span.replace("\n", " ")) for span in spans]
    for words in found:
        words[1:] = [word if "=" in word or not word.startswith("--") else f"{word}=x" for word in words[1:]]
        words += [need for need in NEEDS.get(words[0], []) if not any(w.startswith(need[:-1]) for w in words)]
    return found


COMMANDS = sorted({tuple(words) for path in DOCUMENTS for words in [*in_blocks(path), *in_sentences(path)]})


class Understood(Exception):
    """The work would begin now."""


def begin(*_: object, **__: object) -> None:
    raise Understood


def written(words: list[str]) -> list[str]:
    """Puts something in the place of what the reader is to fill in."""
    words = [f"{w[:-3]}{STANDS_FOR[w[:-4]]}" if w[:-4] in STANDS_FOR and w.endswith("=...") else w for w in words]
    return [re.sub(r"=\.\.\.$", "=x", word.replace("TASK.yaml", "tool_use.yaml")) for word in words]


def check_ours(program: str, arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module(OURS[program].partition(":")[0])
    monkeypatch.setattr(module, "run" if hasattr(module, "run") else "examine", begin)
    monkeypatch.setattr(sys, "argv", [program, *arguments])
    with pytest.raises(Understood):
        module.main()


def check_theirs(program: str, arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    from lerobot.configs.parser import filter_path_args

    import lerobot_policy_buds  # noqa: F401

    module, name = THEIRS[program].split(":")
    settings = getattr(importlib.import_module(module), name)
    monkeypatch.setattr(sys, "argv", [program])  # where a path of a policy is looked for
    fields = settings.__get_path_fields__() if hasattr(settings, "__get_path_fields__") else []
    # Of a policy that is there, which is looked for where the program has its arguments.
    found = ["--policy.type=buds"] if program == "lerobot-rollout" else []
    packages = [word for word in arguments if ".discover_packages_path=" in word]
    if packages:  # imported before the rest is read, and taken away; here it is the example's
        runpy.run_path(str(ROOT / "examples/5_write_a_task.py"))
    told = filter_path_args(fields, [word for word in arguments if word not in packages])
    draccus.parse(settings, args=[*told, *found])


def check_script(
    path: str, arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.syspath_prepend((ROOT / path).parent)  # as python does
    names = runpy.run_path(str(ROOT / path))
    settings = re.search(r"\bparse\((\w+)\)", (ROOT / path).read_text())
    monkeypatch.setattr(sys, "argv", [path, *arguments])
    if settings:
        from lerobot_buds.cli.running import parse

        parse(names[settings[1]])
    elif arguments:
        monkeypatch.setattr(sys, "argv", [path, "--help"])
        with pytest.raises(SystemExit):
            names["main"]()
        known = set(re.findall(r"(?<!\w)(--\w+)", capsys.readouterr().out))
        assert {word.partition("=")[0] for word in arguments if word.startswith("--")} <= known


def check_make(arguments: list[str]) -> None:
    makefile = (ROOT / "Makefile").read_text()
    for word in arguments:
        name, equals, _ = word.partition("=")
        assert re.search(rf"^{name} \?=" if equals else rf"^{name}:", makefile, flags=re.M), word


@pytest.mark.usefixtures("tasks_of_its_own")
@pytest.mark.parametrize("command", COMMANDS, ids=lambda words: " ".join(words)[:80])
def test_a_command_can_be_typed(
    command: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(ROOT)  # where the files of settings lie
    words = written(list(command))
    if words[0] == "accelerate":  # accelerate launch OPTIONS $(which PROGRAM) OPTIONS
        words = words[words.index("$(which") + 1 :]
        words[0] = words[0].rstrip(")")
    program, *arguments = words
    if program in OURS:
        check_ours(program, arguments, monkeypatch)
    elif program in THEIRS:
        check_theirs(program, arguments, monkeypatch)
    elif program == "make":
        check_make(arguments)
    elif program == "python":
        check_script(arguments[0], arguments[1:], monkeypatch, capsys)
    else:
        pytest.fail(f"{program} is no program of ours or of LeRobot")


def test_what_is_written_wrongly_is_found(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    checks: list[tuple[Callable[[], None], type[BaseException]]] = [
        (lambda: check_ours("lerobot-buds-segment", ["--repo=me/x"], monkeypatch), SystemExit),
        (lambda: check_ours("lerobot-buds-compare", ["--repo_id=me/x", "--seeds=many"], monkeypatch), SystemExit),
        (
            lambda: check_theirs("lerobot-train", ["--policy.type=buds", "--policy.skills_paths=x"], monkeypatch),
            SystemExit,
        ),
        (lambda: check_script("scripts/check_actions.py", ["--polici=x"], monkeypatch, capsys), AssertionError),
        (lambda: check_make(["reproduce", "TABEL=1"]), AssertionError),
    ]
    for check, error in checks:
        with pytest.raises(error):
            check()


def test_a_document_is_run_from_top_to_bottom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd) -> None:
    document = tmp_path / "page.md"
    document.write_text(
        "```\nlerobot-buds-name \\\n    --root=none\nlerobot-buds-doctor\n```\n```python\nlerobot-x\n```\n"
    )
    assert list(in_blocks(document)) == [["lerobot-buds-name", "--root=none"], ["lerobot-buds-doctor"]]
    needy = tmp_path / "needy.md"
    needy.write_text("<!-- needs: a robot -->\n\n```\nlerobot-record\n```\n\n```\nlerobot-eval\n```\n")
    assert list(in_blocks(needy)) == [["lerobot-record"], ["lerobot-eval"]]
    assert list(in_blocks(needy, runnable=True)) == [["lerobot-eval"]]
    monkeypatch.setattr(sys, "argv", ["run_docs.py", str(document), f"--folder={tmp_path / 'here'}"])
    with pytest.raises(SystemExit) as stop:
        runpy.run_path(str(ROOT / "scripts/run_docs.py"), run_name="__main__")
    out, err = capfd.readouterr()
    assert stop.value.code == 1 and "status 1: lerobot-buds-name" in out and "lerobot-buds-doctor" not in out
    assert "is no folder on this machine" in err or "has no segmentation record" in err
