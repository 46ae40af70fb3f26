"""The comparison of methods: every method runs, the oracle is right, and the reports hold what was measured."""

import numpy as np
import pytest
from matplotlib.image import imread

from lerobot_buds.core import ConfigError
from lerobot_buds.evaluation import METHODS, Demonstrations, compare, comparison_rows, comparison_table, draw_comparison
from lerobot_buds.segmentation import DiscoveryConfig

FPS = 20


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(0)
    places = rng.normal(size=(3, 8)) * 3
    latents, stages, position, gripper = [], [], [], []
    for _ in range(6):
        lengths = rng.integers(50, 90, size=3)
        stage = np.repeat(np.arange(3), lengths)
        latents.append(places[stage] + 0.3 * rng.normal(size=(len(stage), 8)))
        stages.append(stage)
        position.append(rng.normal(size=(len(stage), 3)).cumsum(axis=0))
        gripper.append(np.where(stage == 1, 0.0, 0.04))
    return Demonstrations(latents, latents, stages, position, gripper, FPS)


@pytest.fixture(scope="module")
def results(data):
    config = DiscoveryConfig(max_skills=3, min_skill_s=1.0)
    return [result for seed in (0, 1) for result in compare(data, config, seed)]


def test_every_method_labels_every_frame(data, results):
    assert [(r.method, r.seed) for r in results] == [(m, s) for s in (0, 1) for m in METHODS]
    for result in results:
        assert [len(labels) for labels in result.labels] == [len(stages) for stages in data.stages]
        assert result.seconds > 0 and 1 <= result.n_skills <= 3


def test_the_oracle_has_the_true_boundaries(results):
    oracle = next(r for r in results if r.method == "true stages")
    assert oracle.scores.boundary_f1 == oracle.scores.segment_f1 == 1
    assert oracle.label_distance == 0


def test_a_random_cut_is_worse_than_ours(results):
    ours, uniform = (next(r for r in results if r.method == m) for m in ("default", "uniform"))
    assert ours.scores.boundary_f1 > uniform.scores.boundary_f1


def test_an_unknown_method_is_refused(data):
    with pytest.raises(ConfigError, match="Did you mean 'uniform'"):
        compare(data, DiscoveryConfig(), 0, ["uniforme"])


def test_rows_average_over_seeds(results):
    rows = comparison_rows(results)
    assert [row["method"] for row in rows] == list(METHODS)
    first = [r for r in results if r.method == METHODS[0]]
    assert rows[0]["NMI"]["mean"] == pytest.approx(np.mean([r.scores.nmi for r in first]))
    assert rows[0]["seeds"] == [0, 1] and 0 <= rows[0]["seed stability"] <= 1
    skills = rows[0]["segments of skills"]
    assert sum(skill["segments"] for skill in skills) == pytest.approx(first[0].segments * 6)
    frames = sum(skill["segments"] * skill["mean_seconds"] * FPS for skill in skills)
    assert frames == pytest.approx(sum(map(len, first[0].labels)))
    for table in comparison_table(results).split("\n\n"):
        lines = table.splitlines()
        assert len(lines) == 2 + len(METHODS) and len({line.count("|") for line in lines}) == 1


def test_what_papers_print_has_a_table_of_its_own(results):
    header, _, *lines = comparison_table(results).split("\n\n")[1].splitlines()
    assert header == "| method | F1@10 | F1@25 | F1@50 | Edit | MoF | mIoU |"
    (oracle,) = [row for row in comparison_rows(results) if row["method"] == "true stages"]
    assert oracle["MoF"]["mean"] == oracle["F1@50"]["mean"] == 100
    assert "| true stages | 100.0 | 100.0 | 100.0 | 100.0 | 100.0 | 100.0 |" in lines


def test_the_picture_shows_every_method(data, results, tmp_path):
    draw_comparison(tmp_path / "comparison.png", results, data.stages, FPS)
    assert imread(tmp_path / "comparison.png").std() > 0.1
