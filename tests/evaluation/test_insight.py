"""Why episodes failed, and what a run comes to, from hand-made episodes."""

import pytest

from lerobot_buds.core import ConfigError, DatasetError, Segment, read_json, write_json
from lerobot_buds.evaluation.insight import MANIPULATION, WRONG_SKILL, failure_of, failures_of, summarise, summary_table
from lerobot_buds.evaluation.trace import RECORD_FILE, Decision, Episode, RolloutRecord

PERIOD, WINDOW = 5, 20
SETTINGS = {"checkpoint": "abc", "failure_window_s": 1.0}


def episode(seed=0, length=60, foreign="", stages=(None, None), success=False, error="") -> Episode:
    """One decision a period; `foreign` tells of each in turn whether it was foreign: x, or . where it was not."""
    decisions = tuple(
        Decision(PERIOD * i, 0, 1, {"x": True, ".": False, "?": None}[letter]) for i, letter in enumerate(foreign)
    )
    skills = (Segment(0, 10, 0), Segment(10, length, 1)) if length else ()
    return Episode(seed, success, error, skills, decisions, stages)


def record(*episodes: Episode, settings=SETTINGS) -> RolloutRecord:
    return RolloutRecord(settings, "test/task", ("reach", "grasp"), 20, 2, PERIOD, episodes)


@pytest.mark.parametrize(
    ("foreign", "stages", "expected"),
    [
        ("xxxx........", (None, None), WRONG_SKILL),  # the first 20 steps decide where nothing was done
        ("....xxxxxxxx", (None, None), MANIPULATION),
        ("xx..........", (None, None), WRONG_SKILL),  # half of them will do
        ("x...........", (None, None), MANIPULATION),
        ("xxxx....xxxx", (20, None), MANIPULATION),  # judged from step 20 on
        ("....xxxx....", (20, None), WRONG_SKILL),
        ("....xxxx....", (None, 20), WRONG_SKILL),  # whichever stage was last
        ("...xxxx.....", (18, None), WRONG_SKILL),  # from the decision of step 15, in force at step 18
        ("...x.x......", (18, None), MANIPULATION),
        ("...........x", (58, None), WRONG_SKILL),  # little time is left
        ("...........x", (60, None), WRONG_SKILL),  # none is: the last decision is judged
        ("????????????", (None, None), None),
        ("", (None, None), None),
    ],
)
def test_a_failure_is_judged_by_the_decisions_after_the_last_progress(foreign, stages, expected) -> None:
    assert failure_of(episode(foreign=foreign, stages=stages), PERIOD, WINDOW) == expected


def test_successes_and_lost_episodes_are_no_failures() -> None:
    assert failure_of(episode(foreign="x" * 12, success=True), PERIOD, WINDOW) is None
    assert failure_of(episode(foreign="x" * 12, error="diverged"), PERIOD, WINDOW) is None


RUN = (
    episode(0, 40, "." * 8, (10, 40), success=True),
    episode(1, 60, "x" * 12, (30, None)),
    episode(2, 60, "." * 12, (None, None)),
    episode(3, 0, error="no OpenGL"),
)


def test_a_run_is_summed_up_without_its_lost_episodes() -> None:
    summary = summarise(record(*RUN))
    assert (summary["episodes"], summary["errors"]) == (3, 1)
    assert (summary["success"]["successes"], summary["success"]["episodes"]) == (1, 3)
    assert summary["stages"] == [
        {"name": "reach", "done": 2, "episodes": 3, "mean_seconds": 1.0},
        {"name": "grasp", "done": 1, "episodes": 3, "mean_seconds": 2.0},
    ]
    assert summary["failures"] == {WRONG_SKILL: 1, MANIPULATION: 1}
    assert failures_of(record(*RUN)) == [None, WRONG_SKILL, MANIPULATION, None]
    assert summary["foreign_decisions"] == pytest.approx(12 / 32)
    assert (summary["replaced_decisions"], summary["switches"]) == (1.0, 1.0)
    assert (summary["seconds_to_success"], summary["seconds"]) == (2.0, pytest.approx(160 / 60))


def test_the_table_names_every_figure() -> None:
    table = summary_table(record(*RUN))
    for words in (
        "33% success (1 of 3; 95 % interval 6% to 79%)",
        "reach               2 of 3, after 1.0 s on average",
        "1 wrong skill, 1 manipulation",
        "foreign decisions   38%",
        "1 more; run again to repeat them",
    ):
        assert words in table
    assert "not classified" in summary_table(record(episode(foreign="?")))
    assert "every episode was lost" in summary_table(record(RUN[3]))


def test_a_record_is_read_as_it_was_written(tmp_path) -> None:
    written = record(*RUN, episode(4, foreign="?x"))
    written.write(tmp_path, summary={"ignored": 1})
    assert RolloutRecord.read(tmp_path) == written
    assert read_json(tmp_path / RECORD_FILE)["summary"] == {"ignored": 1}


def test_a_run_goes_on_with_what_there_is(tmp_path) -> None:
    empty = record()
    assert empty.resumed(tmp_path) == empty
    record(*RUN).write(tmp_path)
    resumed = empty.resumed(tmp_path)
    assert resumed.episodes == RUN
    assert resumed.finished_seeds == {0, 1, 2}  # the lost one is to be run again
    again = resumed.with_episodes([episode(3, foreign="."), episode(5, foreign=".")])
    assert [(e.seed, e.error) for e in again.episodes] == [(0, ""), (1, ""), (2, ""), (3, ""), (5, "")]


def test_rollouts_of_other_settings_are_not_mixed(tmp_path) -> None:
    record(*RUN).write(tmp_path)
    with pytest.raises(ConfigError, match=r"checkpoint='abc' \(now 'xyz'\)\. Choose another output_dir"):
        record(settings=SETTINGS | {"checkpoint": "xyz"}).resumed(tmp_path)
    with pytest.raises(ConfigError, match="failure_window_s"):
        record(settings={"checkpoint": "abc"}).resumed(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema_version": 99}, "has format 99"),
        ({"episodes": [{"seed": 1}]}, "is damaged"),
        ({"episodes": None}, "is damaged"),
    ],
)
def test_damaged_and_newer_records_are_refused(tmp_path, change, message) -> None:
    record(*RUN).write(tmp_path)
    write_json(tmp_path / RECORD_FILE, read_json(tmp_path / RECORD_FILE) | change)
    with pytest.raises(DatasetError, match=message):
        record().resumed(tmp_path)
    (tmp_path / RECORD_FILE).write_text("{")
    with pytest.raises(DatasetError, match="damaged"):
        record().resumed(tmp_path)
    with pytest.raises(DatasetError, match="does not exist"):
        RolloutRecord.read(tmp_path / "elsewhere")
