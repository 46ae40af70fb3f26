"""Stages are shared between cells, named by what decides their results, and understood by the commands they run."""

import runpy
from dataclasses import replace
from pathlib import Path

import draccus
import pytest
from lerobot.configs.train import TrainPipelineConfig

from lerobot_buds.cli.collect import CollectConfig
from lerobot_buds.cli.rollout import RolloutConfig
from lerobot_buds.cli.segment import SegmentConfig
from lerobot_buds.experiments import Cell, Experiment, Run, Size, plan

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
CPU, PAPER = (Size.read(CONFIGS / f"experiments/sizes/{name}.yaml") for name in ("cpu", "paper"))
IN_MEMORY = runpy.run_path(str(ROOT / "scripts/train_in_memory.py"))["TrainingConfig"]
KINDS = ("collect", "represent", "segment", "train", "evaluate")
SETTINGS = {
    "lerobot-buds-collect": CollectConfig,
    "lerobot-buds-segment": SegmentConfig,
    "lerobot-buds-rollout": RolloutConfig,
    "lerobot-train": TrainPipelineConfig,
    "scripts/train_in_memory.py": IN_MEMORY,
}


def cells(name: str) -> tuple[Cell, ...]:
    return Experiment.read(CONFIGS / f"experiments/{name}.yaml").cells


def runs(name: str, size: Size = CPU, seed: int = 1000) -> list[Run]:
    return [plan(cell, size, seed, CONFIGS) for cell in cells(name)]


def count(planned: list[Run], kind: str) -> int:
    return len({stage.key for run in planned for stage in run.stages if stage.kind == kind})


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("table1", (3, 3, 6, 9, 9)),
        ("table2", (1, 1, 4, 5, 5)),  # one skill for whole demonstrations needs no segmentation
        ("table3", (1, 1, 4, 6, 21)),  # Multi, Test and BC serve all three rows
        ("table4", (1, 4, 4, 4, 4)),
        ("starts", (2, 2, 2, 4, 4)),
    ],
)
def test_cells_share_what_they_have_in_common(name: str, counts: tuple[int, ...]) -> None:
    planned = runs(name)
    assert tuple(count(planned, kind) for kind in KINDS) == counts


def test_tables_share_the_kitchen() -> None:
    kitchen = next(run for run in runs("table1") if (run.cell.row, run.cell.method) == ("Kitchen", "BUDS"))
    full = runs("table4")[0]
    assert [stage.key for stage in kitchen.stages] == [stage.key for stage in full.stages]


def test_another_seed_shares_all_before_the_training() -> None:
    a, b = (runs("table1", seed=seed)[2] for seed in (1000, 1001))
    shared = {s.key for s in a.stages} & {s.key for s in b.stages}
    assert {key.split("-")[0] for key in shared} == {"collect", "represent", "segment"}


def test_more_trials_are_the_same_stage() -> None:
    few, many = (runs("table1", replace(CPU, most_trials=n))[0].evaluations[0] for n in (10, 20))
    assert few.key == many.key and few != many
    assert many.command(Path("/x"))[-1] == "--episodes=20"


def test_a_settings_file_names_the_stage(tmp_path: Path) -> None:
    (tmp_path / "configs").symlink_to(CONFIGS)
    before = plan(cells("table1")[2], CPU, 1000, tmp_path / "configs")
    (tmp_path / "configs").unlink()
    for name in (CPU.segment, CPU.policy, "configs/discovery/tool_use.yaml"):
        copy = tmp_path / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes((ROOT / name).read_bytes() + (b"\n" if name == CPU.policy else b""))
    after = plan(cells("table1")[2], CPU, 1000, tmp_path / "configs")
    same = [a.key == b.key for a, b in zip(before.stages, after.stages, strict=True)]
    assert dict(zip([s.kind for s in before.stages], same, strict=True)) == {
        "collect": True,
        "represent": True,
        "segment": True,
        "train": False,
        "evaluate": False,
    }


def test_episodes_of_variants() -> None:
    planned = {(run.cell.row, run.cell.method): run for run in runs("table3")}
    multi = planned["Task-1", "Train (Multi)"].training
    assert multi.options["episodes"] == [*range(80), *range(120, 200), *range(240, 320)]
    single = planned["Task-2", "Train (Single)"]
    assert single.segmentation.options["episodes"] == list(range(120, 240))
    assert single.training.options["episodes"] == list(range(80))  # of its own copy, which holds that task alone
    test = planned["Task-3", "Test"].training
    assert test.options["episodes"] == [*range(80, 120), *range(200, 240), *range(320, 360)]
    assert multi.key in test.options["policy.skills_path"]
    assert planned["Task-1", "BC, all tasks"].training.options["episodes"] == multi.options["episodes"]


@pytest.mark.parametrize("size", [CPU, PAPER], ids=lambda size: size.name)
@pytest.mark.parametrize("name", ["table1", "table3", "starts"])
def test_commands_understand_their_options(name: str, size: Size, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    stages = {stage.key: stage for run in runs(name, size) for stage in run.stages}
    for stage in stages.values():
        program, *options = stage.command(Path("/nowhere"))
        config = draccus.parse(SETTINGS[program], args=options)
        if stage.kind == "train":
            assert config.policy.type == "buds" and config.steps == stage.options["steps"]


def test_a_stage_names_no_folder_of_this_machine() -> None:
    """Else its hash would be another one elsewhere."""
    values = [str(value) for run in runs("table3") for stage in run.stages for value in stage.options.values()]
    assert not [value for value in values if value.startswith("/") or str(ROOT) in value]
