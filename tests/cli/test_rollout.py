"""The whole command with a small untrained policy: what it leaves, how it goes on, and what it refuses."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import pytest
from lerobot.envs import PushtEnv

from lerobot_buds.cli import rollout
from lerobot_buds.cli.rollout import RolloutConfig, roll_out
from lerobot_buds.core import CheckpointError, ConfigError, DatasetError, read_json, write_json
from lerobot_buds.envs.configuration_robosuite import RobosuiteEnvConfig
from lerobot_buds.evaluation.trace import RolloutRecord

pytestmark = pytest.mark.slow

STEPS = 12
ENV = {"episode_length": STEPS, "image_size": 32, "render_profile": "fastest"}


@pytest.fixture(scope="module")
def settings(segmented: Path, checkpoint: Path) -> Callable[..., RolloutConfig]:
    """Makes settings of a run of two episodes of twelve steps, both at once."""

    def settings(output: Path, env: dict[str, Any] | None = None, **changes: Any) -> RolloutConfig:
        known = {"policy_path": str(checkpoint), "dataset_root": segmented, "episodes": 2, "batch_size": 2}
        return RolloutConfig(output_dir=output, env=RobosuiteEnvConfig(**ENV | (env or {})), **known | changes)

    return settings


@pytest.fixture(scope="module")
def output(settings, tmp_path_factory) -> Path:
    """The folder of a finished run."""
    folder = tmp_path_factory.mktemp("rollouts") / "run"
    roll_out(settings(folder))
    return folder


def test_a_run_leaves_a_record_a_picture_and_a_video_an_episode(output: Path) -> None:
    assert {str(p.relative_to(output)) for p in output.rglob("*") if p.is_file()} == {
        "rollouts.json",
        "ribbons.png",
        "videos/seed_500000.mp4",
        "videos/seed_500001.mp4",
    }
    record = RolloutRecord.read(output)
    assert (record.task, record.stages) == ("multitask_kitchen/task3_variant1", ("close_drawer", "push_pot"))
    assert [episode.seed for episode in record.episodes] == [500_000, 500_001]
    for episode in record.episodes:
        assert (episode.length, episode.success, episode.error) == (STEPS, False, "")
        assert [decision.step for decision in episode.decisions] == [0, 5, 10]
        assert [decision.skill for decision in episode.decisions] == episode.labels[::5].tolist()
        assert all(decision.proposed == decision.skill for decision in episode.decisions)
        assert all(decision.foreign in (True, False) for decision in episode.decisions)
        assert episode.stage_steps == (None, None)
    content = read_json(output / "rollouts.json")
    assert set(content["failures"]) == {"500000", "500001"}
    assert sum(content["summary"]["failures"].values()) == content["summary"]["episodes"] == 2
    with av.open(str(output / "videos/seed_500000.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) == STEPS + 1


def test_a_run_can_be_repeated_to_the_last_byte(settings, output: Path, tmp_path: Path) -> None:
    roll_out(settings(tmp_path / "again"))
    for name in ("rollouts.json", "ribbons.png", "videos/seed_500001.mp4"):
        assert (tmp_path / "again" / name).read_bytes() == (output / name).read_bytes()


def test_an_interrupted_run_goes_on(settings, output: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_episodes, seeds = rollout.run_episodes, []

    def interrupted(envs, checkpoint, decider, recorders, on_end):
        if len(seeds) == 1:
            raise KeyboardInterrupt
        seeds.extend(recorder.seed for recorder in recorders)
        run_episodes(envs, checkpoint, decider, recorders, on_end)

    with monkeypatch.context() as patch:
        patch.setattr(rollout, "run_episodes", interrupted)
        with pytest.raises(KeyboardInterrupt):
            roll_out(settings(tmp_path / "run", batch_size=1))
    first = RolloutRecord.read(tmp_path / "run")
    assert [episode.seed for episode in first.episodes] == seeds == [500_000]
    video = tmp_path / "run/videos/seed_500000.mp4"
    written = video.stat().st_mtime_ns

    whole = roll_out(settings(tmp_path / "run", batch_size=1))
    assert [episode.seed for episode in whole.episodes] == [500_000, 500_001]
    assert whole.episodes[0] == first.episodes[0] and video.stat().st_mtime_ns == written
    assert whole.episodes == RolloutRecord.read(output).episodes  # whatever runs beside an episode

    def never(*_):
        raise AssertionError("everything was done")

    monkeypatch.setattr(rollout, "run_episodes", never)
    assert roll_out(settings(tmp_path / "run")) == whole  # the size of batches is no setting of an episode


def test_demonstrations_can_stand_in_and_videos_be_left_out(settings, tmp_path: Path) -> None:
    record = roll_out(
        settings(tmp_path / "run", skills_from="stages", subgoals_from="demonstrations", episodes=1, video=False)
    )
    assert [path.name for path in (tmp_path / "run").iterdir() if path.is_file()] == ["rollouts.json", "ribbons.png"]
    (episode,) = record.episodes
    assert not any(decision.foreign for decision in episode.decisions)  # the hand has hardly moved


def test_without_a_dataset_failures_are_not_classified(settings, tmp_path: Path, capsys, monkeypatch) -> None:
    config = settings(tmp_path / "run", dataset_root=None, episodes=1, video=False)
    monkeypatch.setattr(rollout, "parse", lambda _: config)
    rollout.main()
    printed = capsys.readouterr().out
    assert "multitask_kitchen/task3_variant1, 1 episodes, seeds 500000 to 500000" in printed
    assert "not classified" in printed and "close_drawer" in printed and "0% success (0 of 1" in printed
    content = read_json(tmp_path / "run/rollouts.json")
    assert content["failures"] == {} and content["summary"]["failures"] is None


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"env": {"task": "multitask_kitchen/task9"}}, ConfigError, "no robosuite task"),
        ({"env": {"task": "multitask_kitchen"}}, ConfigError, "names 9 tasks"),
        ({"env": {"task": "tool_use/full"}}, ConfigError, "does not know the task"),
        ({"env": {"fps": 10}}, CheckpointError, "trained at 20 frames a second, the environment runs at 10"),
        ({"env": {"render_profile": "fast"}}, CheckpointError, "--env.render_profile=fastest"),
        ({"skills_from": "stage"}, ConfigError, "Did you mean 'stages'"),
        ({"subgoals_from": "stages"}, ConfigError, "is unknown"),
        ({"skills_from": "demonstrations", "dataset_root": None}, ConfigError, "give their segmented dataset"),
        ({"episodes": 0}, ConfigError, "at least 1"),
        ({"failure_window_s": 0.0}, ConfigError, "must be positive"),
        ({"policy_path": "no such/place at all"}, CheckpointError, "neither a folder"),
    ],
)
def test_what_cannot_work_is_refused_before_anything_is_made(settings, tmp_path, changes, error, message) -> None:
    with pytest.raises(error, match=message):
        roll_out(settings(tmp_path / "run", **changes))
    assert not list(tmp_path.iterdir())


def test_another_environment_is_refused(settings, tmp_path: Path) -> None:
    config = settings(tmp_path / "run")
    config.env = PushtEnv()
    with pytest.raises(ConfigError, match="'pusht'"):
        roll_out(config)


def test_a_folder_that_is_no_checkpoint_of_this_policy_is_refused(settings, checkpoint: Path, tmp_path: Path) -> None:
    broken = shutil.copytree(checkpoint, tmp_path / "broken")

    def refusal() -> str:
        with pytest.raises(CheckpointError) as error:
            roll_out(settings(tmp_path / "run", policy_path=str(broken)))
        return str(error.value)

    content = read_json(broken / "config.json")
    write_json(broken / "config.json", content | {"type": "act"})
    assert "type 'act'" in refusal()
    write_json(broken / "config.json", content | {"segmentation": "0" * 64})
    assert "other labels" in refusal()
    write_json(broken / "config.json", content | {"of_a_later_version": 1})
    assert "settings that this version does not understand" in refusal()
    (broken / "config.json").write_text("{")
    assert "damaged" in refusal()
    (broken / "model.safetensors").unlink()
    assert "lacks model.safetensors" in refusal()
    assert not (tmp_path / "run").exists()


def test_a_folder_of_other_settings_is_refused(settings, output: Path, tmp_path: Path) -> None:
    before = (output / "rollouts.json").read_bytes()
    changes: list[tuple[dict[str, Any], str]] = [
        ({"seed": 7}, "seed=500000 .now 7."),
        ({"env": {"episode_length": 50}}, "episode_length=12 .now 50."),
        ({"dataset_root": None}, "labels="),
    ]
    for change, message in changes:
        with pytest.raises(ConfigError, match=message):
            roll_out(settings(output, **change))
    assert (output / "rollouts.json").read_bytes() == before


def test_a_dataset_without_stages_cannot_tell_them(settings, segmented: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(segmented, tmp_path / "copy")
    collection = read_json(copy / "meta/buds/collection.json")
    write_json(copy / "meta/buds/collection.json", collection | {"stages": []})
    with pytest.raises(DatasetError, match="does not tell the stages"):
        roll_out(settings(tmp_path / "run", dataset_root=copy, skills_from="stages"))
