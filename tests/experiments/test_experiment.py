"""The experiments' files say what the paper says, and nothing that is not understood."""

from pathlib import Path

import pytest

from lerobot_buds.core import ConfigError
from lerobot_buds.experiments import Experiment, Size

CONFIGS = Path(__file__).parents[2] / "configs/experiments"

PUBLISHED = {
    "table1": [54.0, 36.8, 58.6, 47.8, 60.4, 68.6, 24.4, 23.4, 72.0],
    "table2": [0.0, 24.2, 72.0, 60.6, 44.6],
    "table3": [70.2, 52.6, 59.0, None, 59.8, 60.8, 55.3, None, 75.0, 67.6, 28.4, None],
    "table4": [72.0, 41.4, 7.4, 36.8],
    "starts": [63.0, 60.3, 0.0, 58.6],
    "real_kitchen": [18.0, 56.0],
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_figures(name: str) -> None:
    experiment = Experiment.read(CONFIGS / f"{name}.yaml")
    assert [c.published and c.published[0] for c in experiment.cells] == PUBLISHED[name]
    assert experiment.reference in experiment.methods


def test_means_that_the_paper_derives() -> None:
    cells = Experiment.read(CONFIGS / "table1.yaml").cells
    means = {m: sum(c.published[0] for c in cells if c.method == m) / 3 for m in ("BC", "CP", "BUDS")}
    assert {m: round(mean, 1) for m, mean in means.items()} == {"BC": 42.1, "CP": 40.2, "BUDS": 66.4}


@pytest.mark.parametrize("file", sorted(CONFIGS.glob("*.yaml")), ids=lambda file: file.stem)
def test_every_experiment_can_be_read(file: Path) -> None:
    experiment = Experiment.read(file)
    assert len({cell.name for cell in experiment.cells}) == len(experiment.cells) > 0
    assert all(cell.recipe.evaluated for cell in experiment.cells)


@pytest.mark.parametrize("file", sorted((CONFIGS / "sizes").glob("*.yaml")), ids=lambda file: file.stem)
def test_every_size_can_be_read(file: Path) -> None:
    size = Size.read(file)
    assert size.name == file.stem
    assert all((CONFIGS.parents[1] / name).exists() for name in (size.segment, size.policy))


def test_later_settings_take_precedence(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(
        "title: mine\nreference: b\n"
        "recipe:\n  demonstrations: tool_use/full\n  policy: {a: 1}\n"
        "  evaluated: 'multitask_kitchen/task{number}_variant1'\n"
        "methods: {a: {policy: {b: 2}}, b: {policy: {a: 3}}}\n"
        "rows: {first: {number: 1}, second: {number: 2, without: [a]}}\n"
        "published: {first: {a: [1.0, 0.5]}}\n"
    )
    cells = Experiment.read(path).cells
    assert [(c.row, c.method, c.recipe.policy) for c in cells] == [
        ("first", "a", {"a": 1, "b": 2}),
        ("first", "b", {"a": 3}),
        ("second", "b", {"a": 3}),
    ]
    assert cells[2].recipe.evaluated == "multitask_kitchen/task2_variant1"
    assert [c.published for c in cells] == [(1.0, 0.5), None, None]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("title: x\nrows: {a: {}}\nmethods: {b: {}}", "there is no \\['reference'\\]"),
        ("title: x\nreference: b\nrows: {a: {}}\nmethods: {b: {}}\nspeed: 1", "\\['speed'\\] are unknown"),
        ("title: x\nreference: b\nrows: {a: {steps: 1}}\nmethods: {b: {}}", "\\['steps'\\] are unknown"),
        (
            "title: x\nreference: b\nrows: {a: {demonstrations: nowhere}}\nmethods: {b: {}}",
            "no robosuite task 'nowhere'",
        ),
        ("title: x\nreference: c\nrows: {a: {}}\nmethods: {b: {}}", "reference='c' is none"),
        ("[1, 2]", "holds no settings"),
        ("{", "cannot be read"),
    ],
)
def test_what_cannot_be_understood_is_refused(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(content)
    with pytest.raises(ConfigError, match=message):
        Experiment.read(path)
