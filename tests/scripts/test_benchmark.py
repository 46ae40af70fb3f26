"""Every part of the benchmark runs, and the plain loop that the policy is timed against does the original's work."""

import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.policies import make_policy, make_pre_post_processors

from lerobot_buds.core import ConfigError, read_json
from lerobot_buds.policy import BudsConfig

pytestmark = pytest.mark.slow

SMALL = {"encoder": "conv", "norm": "group", "conv_channels": [8, 8], "keypoints": 8, "head_widths": [32]}


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "scripts"))
    threads = torch.get_num_threads()
    yield import_module("benchmark")
    torch.set_num_threads(threads)
    for name in [name for name in sys.modules if name.partition(".")[0] in ("benchmark", "benchmarks")]:
        del sys.modules[name]


PARTS = ("commands", "recording", "rendering", "loading", "representation", "discovery", "training", "acting")


@pytest.mark.parametrize("part", [*PARTS, "growth", "scale"])
def test_a_part_measures_something_of_all_that_it_compares(script: ModuleType, part: str, tmp_path: Path) -> None:
    config = script.BenchmarkConfig([part], size="tiny", output=tmp_path, threads=1)
    (figures,) = script.measured(config).values()
    assert len(figures) > 0 and all(math.isfinite(figure.value) and figure.value >= 0 for figure in figures)
    names = {figure.what for figure in figures}
    assert {figure.against for figure in figures} - {""} <= names
    kept = read_json(tmp_path / "benchmark.json")["figures"][part]
    assert [figure["what"] for figure in kept] == [figure.what for figure in figures]
    for figure, told in zip(figures, kept, strict=True):
        assert (told["times"] is None) == (figure.against == "")


def test_parts_are_named_in_full(script: ModuleType) -> None:
    assert set(script.PARTS) == {*PARTS, "growth", "scale"}
    with pytest.raises(ConfigError, match=r"no part 'actin'.*acting"):
        script.measured(script.BenchmarkConfig(["actin"]))
    with pytest.raises(ConfigError, match="no size 'small'"):
        script.measured(script.BenchmarkConfig(size="small"))


def test_less_time_and_a_higher_rate_are_more(script: ModuleType) -> None:
    seconds = script.Figure("a", 2.0, "s")
    assert replace(seconds, value=1.0).times(seconds) == 2.0
    rate = script.Figure("b", 2.0, "frames/s")
    assert replace(rate, value=1.0).times(rate) == 0.5


def test_tables_say_how_figures_compare(script: ModuleType) -> None:
    slow, fast = script.Figure("slow", 2.0, "s"), script.Figure("fast", 0.5, "s", against="slow")
    table = script.in_table({"part": [slow, fast, script.Figure("grows", 1.0, "s", at=3)]})
    assert table.splitlines()[2:4] == ["| slow | 2 s |  |", "| fast | 0.5 s | 4.00 times slow |"]
    assert "grows" not in table


def test_the_page_has_the_tables_of_its_file(script: ModuleType) -> None:
    docs = Path(__file__).parents[2] / "docs"
    kept = read_json(docs / "performance/cpu.json")["figures"]
    figures = {
        part: [script.Figure(**{key: value for key, value in told.items() if key != "times"}) for told in kept[part]]
        for part in script.PARTS
    }
    tables = (
        (docs / "performance.md").read_text().partition("<!-- benchmark -->")[2].partition("<!-- /benchmark -->")[0]
    )
    assert tables.strip() == script.in_table(figures).strip()


def test_growth_is_drawn_by_unit(script: ModuleType, tmp_path: Path) -> None:
    figures = [script.Figure("update", 0.1 * at, unit, at=at) for at in (1, 3) for unit in ("s", "ms")]
    script.draw(figures, tmp_path / "growth.png", "skills")
    assert (tmp_path / "growth.png").stat().st_size > 5_000


def test_the_plain_loop_trains_the_meta_controllers_of_all_tasks(script: ModuleType, segmented: Path) -> None:
    meta = LeRobotDatasetMetadata("tests/x", root=segmented)
    tasks = [str(meta.tasks.index[0]), "Boil the pot"]
    policy = make_policy(BudsConfig(device="cpu", tasks=tasks, **SMALL), ds_meta=meta)
    prepare, _ = make_pre_post_processors(policy.config, dataset_stats=meta.stats)
    dataset = LeRobotDataset("tests/x", root=segmented)
    batch: dict[str, Any] = prepare(torch.utils.data.default_collate([dataset[row] for row in range(4)]))
    heads = [controller.id_head[0].weight for controller in policy.model.meta_controllers.controllers]
    before = [head.detach().clone() for head in heads]
    import_module("benchmarks.training").separate_networks(policy)({**batch, "task": tasks * 2})
    assert not any(map(torch.equal, heads, before))
