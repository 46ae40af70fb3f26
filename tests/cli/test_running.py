"""Settings are what was typed: text stays text, paths are absolute, empty is empty, an error is one line."""

import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from lerobot_buds.cli.collect import CollectConfig
from lerobot_buds.cli.compare import CompareConfig
from lerobot_buds.cli.doctor import DoctorConfig
from lerobot_buds.cli.import_hdf5 import ImportConfig
from lerobot_buds.cli.rollout import RolloutConfig
from lerobot_buds.cli.running import dataset_root, parse
from lerobot_buds.cli.segment import SegmentConfig

REQUIRED = {
    CollectConfig: [],
    CompareConfig: ["--repo_id=me/x"],
    ImportConfig: ["--source=demo.hdf5", "--repo_id=me/x"],
    RolloutConfig: ["--policy_path=p", "--output_dir=o"],
    SegmentConfig: ["--repo_id=me/x"],
}


@dataclass
class Inner:
    """Settings within settings."""

    name: str = "x"
    folder: Path = Path("inside")


@dataclass
class Outer:
    """Settings of all kinds."""

    name: str = "x"
    task: str | None = None
    number: float = 0.0
    names: list[str] = field(default_factory=lambda: ["a"])
    places: dict[str, str] | None = None
    folder: Path | None = None
    inner: Inner = field(default_factory=Inner)


def parsed[T](settings: type[T], arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> T:
    monkeypatch.setattr(sys, "argv", ["command", *arguments])
    return parse(settings)


TEXTS = [
    "0012",
    "2020-01-02",
    "12:30:00",
    "yes",
    "1e3",
    "[1]*{}",
    "pick: the cube",
    "a # b",
    "*",
    "'quoted'",
    "été 🤖",
    " x ",
]


@pytest.mark.parametrize("text", TEXTS)
def test_text_stays_text(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    config = parsed(Outer, [f"--name={text}", f"--inner.name={text}", "--task", text], monkeypatch)
    assert (config.name, config.inner.name, config.task) == (text, text, text)


def test_texts_within_lists_and_dictionaries_stay_text(monkeypatch: pytest.MonkeyPatch) -> None:
    config = parsed(Outer, ["--names=[0012, 2020-01-02, yes]", "--places={0012: yes, b: 3.0}"], monkeypatch)
    assert config.names == ["0012", "2020-01-02", "yes"]
    assert config.places == {"0012": "yes", "b": "3.0"}


def test_empty_is_empty_and_null_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    config = parsed(Outer, ["--names=[]", "--places={}", "--task=null", "--name=null", "--number=0"], monkeypatch)
    assert (config.names, config.places, config.task, config.name, config.number) == ([], {}, None, "null", 0.0)
    config = parsed(ImportConfig, [*REQUIRED[ImportConfig], "--cameras={}", "--state=[]"], monkeypatch)
    assert (config.cameras, config.state) == ({}, [])


@pytest.mark.parametrize(("typed", "rate"), [("20", 20.0), ("20.0", 20.0), ("29.97", 29.97)])
def test_rates_may_be_written_with_a_point(typed: str, rate: float, monkeypatch: pytest.MonkeyPatch) -> None:
    assert parsed(ImportConfig, [*REQUIRED[ImportConfig], f"--fps={typed}"], monkeypatch).fps == rate


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        (CollectConfig, "root"),
        (CollectConfig, "preview"),
        (CompareConfig, "root"),
        (CompareConfig, "work_dir"),
        (ImportConfig, "root"),
        (ImportConfig, "source"),
        (ImportConfig, "assets"),
        (RolloutConfig, "output_dir"),
        (RolloutConfig, "dataset_root"),
        (SegmentConfig, "root"),
        (SegmentConfig, "output_root"),
        (SegmentConfig, "work_dir"),
    ],
)
@pytest.mark.parametrize("folder", ["run-10:30", "0012"])
def test_folders_are_absolute_in_every_command(
    settings: type, name: str, folder: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = [argument for argument in REQUIRED[settings] if not argument.startswith(f"--{name}=")]
    assert getattr(parsed(settings, [*arguments, f"--{name}={folder}"], monkeypatch), name) == tmp_path / folder


def test_folders_within_settings_and_of_datasets_are_absolute(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    assert parsed(Outer, ["--inner.folder=run-10:30"], monkeypatch).inner.folder == tmp_path / "run-10:30"
    assert dataset_root("me/x", "run-10:30") == tmp_path / "run-10:30"
    assert dataset_root("me/x", None).is_absolute()


@pytest.mark.parametrize("settings", [*REQUIRED, DoctorConfig])
def test_an_argument_that_cannot_be_read_ends_in_one_line(settings: type, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SystemExit) as stopped:
        parsed(settings, [*REQUIRED.get(settings, []), "--config_path=absent.yaml"], monkeypatch)
    assert str(stopped.value).startswith("error: ") and "absent.yaml" in str(stopped.value)
    assert "\n" not in str(stopped.value)


@pytest.mark.parametrize(
    ("argument", "refusal"),
    [
        ("--cameras={front: [}", "--cameras={front: [} is not written as YAML has it"),
        ("--fps=[1]*{}", "error: "),
        ("--fps=fast", "fps"),
    ],
)
def test_values_that_are_no_yaml_are_refused(argument: str, refusal: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SystemExit) as stopped:
        parsed(ImportConfig, [*REQUIRED[ImportConfig], argument], monkeypatch)
    assert refusal in str(stopped.value) and str(stopped.value).startswith("error: ")


def test_a_settings_file_says_what_is_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "settings.yaml"
    for content, name, value in (("name: 0012", "name", "10"), ("inner: {name: 2020-01-02}", "name", "datetime.date")):
        file.write_text(content)
        with pytest.raises(SystemExit, match=f"{name} is read as {value}.*in quotes"):
            parsed(Outer, [f"--config_path={file}"], monkeypatch)
    file.write_text('name: "0012"\nfolder: run-10:30')
    monkeypatch.chdir(tmp_path)
    config = parsed(Outer, ["--config_path", str(file)], monkeypatch)
    assert (config.name, config.folder) == ("0012", tmp_path / "run-10:30")
