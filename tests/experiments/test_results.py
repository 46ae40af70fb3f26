"""Results are kept whole and compared in pairs; the report says all of it, and what is committed says no more."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from scipy.stats import binom

from lerobot_buds.core import DatasetError, read_json, write_json
from lerobot_buds.experiments import CellResult, Paired, Pooled, Trial, paired
from lerobot_buds.experiments.report import load_results, read_configs, readme_with_results, report, write_report
from lerobot_buds.experiments.tables import _likeness

ROOT = Path(__file__).parents[2]
CONFIGS, RESULTS = ROOT / "configs/experiments", ROOT / "docs/results"


def trial(seed: int, success: bool, task: str = "kitchen/full", failure: str | None = None) -> Trial:
    return Trial(task, seed, success, 300, (10, None), 3, failure)


def result(outcomes: str, method: str = "BUDS", seed: int = 1000, **changes: object) -> CellResult:
    """One character a trial: + success, w wrong skill, m manipulation, - a failure that nobody judged."""
    kinds = {"w": "wrong_skill", "m": "manipulation"}
    trials = tuple(trial(500_000 + n, c == "+", failure=kinds.get(c)) for n, c in enumerate(outcomes))
    known = CellResult(
        experiment="table1",
        size="cpu",
        row="Kitchen",
        method=method,
        seed=seed,
        trials=trials,
        steps=6000,
        seconds={"train": 90.0},
        machine="2 CPU cores",
        commit="abc",
        versions={"torch": "2"},
        data="d",
        labels="l",
        segmentation={"n_skills": 6, "agreement": None},
    )
    return replace(known, **changes)


def test_a_result_is_read_as_it_was_written(tmp_path: Path) -> None:
    written = result("+w-m")
    written.write(tmp_path / "a.json")
    assert CellResult.read(tmp_path / "a.json") == written
    assert written.rate.successes == 1 and written.rate.episodes == 4


@pytest.mark.parametrize("damage", [{"schema_version": 99}, {"trials": [{}]}, {"speed": 1}])
def test_a_damaged_result_is_refused(tmp_path: Path, damage: dict) -> None:
    result("+").write(tmp_path / "a.json")
    write_json(tmp_path / "a.json", read_json(tmp_path / "a.json") | damage)
    with pytest.raises(DatasetError, match=r"a\.json"):
        CellResult.read(tmp_path / "a.json")


def test_trainings_are_pooled() -> None:
    pooled = Pooled((result("++++"), result("++--", seed=1001)))
    assert pooled.mean == 75 and pooled.spread == pytest.approx(35.355, abs=1e-3) and pooled.seeds == [1000, 1001]
    assert (pooled.rate.successes, pooled.rate.episodes) == (6, 8)
    assert Pooled((result("+"),)).spread is None


def test_pairs_are_of_the_same_training_seed_task_and_episode() -> None:
    first = Pooled((result("+++-+"), result("++", seed=1001)))
    second = Pooled((result("-+--", method="BC"), result("++", method="BC", seed=1002)))
    pair = paired(first, second)
    assert (pair.first_alone, pair.second_alone, pair.episodes) == (2, 0, 4)
    assert pair.p_value == pytest.approx(2 * binom.cdf(0, 2, 0.5))
    assert paired(first, first).p_value == 1


@pytest.mark.parametrize(("alone", "p"), [((18, 1), 7.63e-5), ((9, 0), 0.00391), ((3, 1), 0.625)])
def test_mcnemar(alone: tuple[int, int], p: float) -> None:
    both = Pooled((result("+" * alone[0] + "-" * alone[1]),)), Pooled((result("-" * alone[0] + "+" * alone[1]),))
    assert paired(*both).p_value == pytest.approx(p, rel=1e-2)


def test_rows_are_counted_together() -> None:
    assert Paired(1, 2, 10) + Paired(3, 0, 20) == Paired(4, 2, 30)


@pytest.mark.parametrize(
    ("means", "likeness"),
    [
        ({"a": 3, "b": 2, "c": 1}, "as in the paper"),
        ({"a": 3, "b": 3, "c": 1}, "as in the paper but for ties"),
        ({"a": 3, "b": 1, "c": 2}, "not as in the paper"),
    ],
)
def test_likeness_of_orders(means: dict, likeness: str) -> None:
    assert _likeness(["a", "b", "c"], means) == likeness


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """Results of one table in a project of their own."""
    results = tmp_path / "docs/results"
    for name, method, outcomes in (("buds", "BUDS", "+++m"), ("bc", "BC", "+--+"), ("cp", "CP", "w---")):
        labels = None if method == "BC" else "l"
        result(outcomes, method, labels=labels).write(results / f"table1/cpu/kitchen.{name}.1000.json")
    (tmp_path / "README.md").write_text("before\n<!-- results -->\nold\n<!-- /results -->\nafter\n")
    return tmp_path


def test_the_report_says_what_was_found(project: Path) -> None:
    page = write_report(CONFIGS, project / "docs/results")
    text = page.read_text()
    assert (
        "| Kitchen | BUDS | 72.0 ± 4.0 | **75.0** | 3 of 4 (30% to 95%) | 1000 | 6,000 | 1.5 | 6 | 2 CPU cores |"
        in text
    )
    assert "- Kitchen, from best to worst: BUDS (75), BC (50), CP (0); as in the paper (BUDS, BC, CP)." in text
    assert "| Kitchen | BUDS and BC | 4 | 2 | 1 | 1 |" in text
    assert "| Kitchen | BUDS | manipulation | 9.0 ± 3.6 | 25.0 (1 of 4) |" in text
    assert "| Kitchen | CP | wrong skill |  | 25.0 (1 of 4) |" in text
    assert (project / "docs/results/table1.png").exists() and not (project / "docs/results/table2.png").exists()
    readme = (project / "README.md").read_text()
    assert "| Kitchen | 2 of 4 (15% to 85%) | 3 of 4 (30% to 95%) | 64 pixels, CPU preset | 1000 |" in readme
    assert "old" not in readme and readme.startswith("before\n") and readme.endswith("after\n")


def test_readme_sets_a_variant_of_flat_beside_the_same_variant_of_ours(project: Path) -> None:
    results = project / "docs/results"
    for method, outcomes in {"BC": "----", "BUDS": "+---", "BC, moving": "++--", "BUDS, moving": "+++-"}.items():
        named = result(outcomes, method, labels=None if "BC" in method else "l", experiment="people")
        named.write(results / f"people/cpu/kitchen.{method}.1000.json".lower().replace(", ", "__"))
    write_report(CONFIGS, results)
    people = [line for line in (project / "README.md").read_text().splitlines() if "people" in line]
    assert [line.split(" | ")[:3] for line in people] == [
        ["| demonstrated as people do it: Kitchen", "0 of 4 (0% to 49%)", "1 of 4 (5% to 70%)"],
        ["| demonstrated as people do it: Kitchen, moving", "2 of 4 (15% to 85%)", "3 of 4 (30% to 95%)"],
    ]


def test_every_published_value_is_in_the_report(project: Path) -> None:
    experiments, sizes = read_configs(CONFIGS)
    for results in (project / "docs/results", project / "nothing"):
        text = report(experiments, sizes, results)
        for experiment in experiments:
            part = text.split(f"## {experiment.title}\n")[1].split("\n## ")[0]
            for cell in experiment.cells:
                if cell.published is not None:
                    mean, spread = cell.published
                    assert f"{mean:.1f}" + ("" if spread is None else f" ± {spread:.1f}") in part, (
                        cell.row,
                        cell.method,
                    )


def test_the_report_is_the_one_of_the_results() -> None:
    """Nothing in it is typed by hand."""
    experiments, sizes = read_configs(CONFIGS)
    assert (ROOT / "docs/results.md").read_text() == report(experiments, sizes, RESULTS)
    readme = (ROOT / "README.md").read_text()
    assert "<!-- results -->" in readme and "<!-- demo -->" in readme
    assert readme == readme_with_results(readme, experiments, sizes, RESULTS)


def test_readme_says_of_people_what_docs_say() -> None:
    (figure,) = re.findall(r"boundary F1 ([\d.]+) against the gripper", (ROOT / "README.md").read_text())
    assert f"| panda_pick_place | default | {figure} |" in (ROOT / "docs/human.md").read_text()


def test_committed_results_are_whole() -> None:
    experiments, sizes = read_configs(CONFIGS)
    for experiment in experiments:
        known = {(size.name, cell.row, cell.method) for size in sizes for cell in experiment.cells}
        found = load_results(RESULTS, experiment)
        assert set(found) <= known
        for pooled in found.values():
            for one in pooled.results:
                assert (
                    one.trials
                    and one.commit
                    and one.data
                    and len({(t.task, t.seed) for t in one.trials}) == len(one.trials)
                )
                assert all(500_000 <= t.seed < 600_000 for t in one.trials)
