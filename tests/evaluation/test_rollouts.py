import json

import pytest

from lerobot_buds.core import DatasetError
from lerobot_buds.evaluation import read_success_rate, success_rate


def test_the_interval_is_wilsons():
    rate = success_rate(28, 50)
    # The paper's real-robot result, 56 % of 50: 42.3 to 68.8 by an independent computation.
    assert (rate.rate, round(rate.low, 3), round(rate.high, 3)) == (0.56, 0.423, 0.688)
    assert str(rate) == "56% success (28 of 50; 95 % interval 42% to 69%)"


def test_all_tasks_of_a_report_count(tmp_path):
    report = tmp_path / "eval_info.json"
    tasks = [{"metrics": {"successes": [True, False]}}, {"metrics": {"successes": [True, True]}}]
    report.write_text(json.dumps({"per_task": tasks}))
    rate = read_success_rate(report)
    assert (rate.successes, rate.episodes) == (3, 4)


def test_a_report_without_episodes_is_refused(tmp_path):
    report = tmp_path / "eval_info.json"
    report.write_text(json.dumps({"per_task": []}))
    with pytest.raises(DatasetError, match="no episodes"):
        read_success_rate(report)
