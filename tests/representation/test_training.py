from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lerobot_buds.core import ConfigError, DatasetError
from lerobot_buds.representation import RepresentationConfig, encode_dataset, train_representation, trained
from lerobot_buds.representation.run import CHECKPOINT_FILE, TrainingRun
from lerobot_buds.representation.trained import RECORD_FILE, WEIGHTS_FILE
from lerobot_buds.representation.training import split_episodes

SMALL = RepresentationConfig(
    image_size=16, latent_dim=4, steps=30, batch_size=16, checkpoint_interval=10, validation_fraction=0.25, device="cpu"
)


class Killed(Exception):
    """Stands for a kill between two steps."""


def bytes_of(folder: Path) -> tuple[bytes, bytes]:
    return (folder / WEIGHTS_FILE).read_bytes(), (folder / RECORD_FILE).read_bytes()


def train_until_killed(
    monkeypatch: pytest.MonkeyPatch, root: Path, config: RepresentationConfig, run: Path, cache: Path
) -> None:
    """Dies before step 25, after the checkpoint of step 20."""
    whole_step = TrainingRun.step

    def step_or_die(self: TrainingRun, step: int) -> None:
        if step == 25:
            raise Killed
        whole_step(self, step)

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(TrainingRun, "step", step_or_die)
        train_representation(root, config, run, cache)


@pytest.fixture(scope="session")
def unbroken(toy_root: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("unbroken")
    train_representation(toy_root, SMALL, folder / "run", folder / "cache")
    return folder / "run", folder / "cache"


def test_training_reduces_training_and_validation_loss(toy_root: Path, tmp_path: Path) -> None:
    config = replace(SMALL, steps=150, checkpoint_interval=1, patience=0)
    losses = train_representation(toy_root, config, tmp_path / "run", tmp_path).losses
    assert len(losses) == 150 and losses[-1]["step"] == 150
    for name in ("training/loss", "validation/loss", "training/observation.images.wrist", "training/proprioception"):
        assert losses[-1][name] < 0.6 * losses[0][name]


def test_same_seed_gives_equal_bytes_and_another_seed_does_not(
    toy_root: Path, unbroken: tuple[Path, Path], tmp_path: Path
) -> None:
    run, cache = unbroken
    twin = train_representation(toy_root, SMALL, tmp_path / "twin", cache)
    assert bytes_of(run) == bytes_of(tmp_path / "twin")
    other = train_representation(toy_root, replace(SMALL, seed=1), tmp_path / "other", cache)
    assert twin.hash != other.hash
    for ours, theirs in zip(
        encode_dataset(toy_root, twin, 7, tmp_path), encode_dataset(toy_root, twin, 7, cache), strict=True
    ):
        np.testing.assert_array_equal(ours, theirs)


def test_killed_and_resumed_equals_unbroken(
    toy_root: Path, unbroken: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, cache = unbroken
    train_until_killed(monkeypatch, toy_root, SMALL, tmp_path / "run", cache)
    assert (tmp_path / "run" / CHECKPOINT_FILE).exists()
    done: list[int] = []
    whole_step = TrainingRun.step
    with monkeypatch.context() as patch:
        patch.setattr(TrainingRun, "step", lambda self, step: (done.append(step), whole_step(self, step)))
        train_representation(toy_root, SMALL, tmp_path / "run", cache)
    assert done == list(range(20, 30))
    assert bytes_of(run) == bytes_of(tmp_path / "run")
    assert sorted(p.name for p in (tmp_path / "run").iterdir()) == [RECORD_FILE, WEIGHTS_FILE]


def test_finished_run_is_loaded_and_a_changed_one_is_trained(
    toy_root: Path, unbroken: tuple[Path, Path], tmp_path: Path
) -> None:
    run, cache = unbroken
    before = (run / WEIGHTS_FILE).stat().st_mtime_ns
    train_representation(toy_root, SMALL, run, cache)
    assert (run / WEIGHTS_FILE).stat().st_mtime_ns == before
    train_representation(toy_root, replace(SMALL, steps=2), tmp_path, cache)
    assert train_representation(toy_root, replace(SMALL, steps=3), tmp_path, cache).losses[-1]["step"] == 3


def test_checkpoint_of_another_configuration_is_not_continued(
    toy_root: Path, unbroken: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, cache = unbroken
    train_until_killed(monkeypatch, toy_root, replace(SMALL, seed=5), tmp_path, cache)
    train_representation(toy_root, SMALL, tmp_path, cache)
    assert bytes_of(run) == bytes_of(tmp_path)


def test_a_kill_while_one_representation_replaces_another_leaves_no_mixture(
    toy_root: Path, unbroken: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, cache = unbroken
    train_representation(toy_root, replace(SMALL, steps=2), tmp_path, cache)

    def die(*_: object) -> None:
        raise Killed

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(trained, "write_json", die)  # between the weights and their record
        train_representation(toy_root, SMALL, tmp_path, cache)
    train_representation(toy_root, SMALL, tmp_path, cache)
    assert bytes_of(run) == bytes_of(tmp_path)


def test_divergence_is_said(toy_root: Path, unbroken: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="training diverged"):
        train_representation(toy_root, replace(SMALL, learning_rate=1e12), tmp_path, unbroken[1])


@pytest.mark.parametrize(
    ("episodes", "fraction", "held_out"), [(1, 0.5, 0), (2, 0.9, 1), (10, 0.1, 1), (40, 0.1, 4), (5, 0.0, 0)]
)
def test_episodes_are_split_whole(episodes: int, fraction: float, held_out: int) -> None:
    training, validation = split_episodes(episodes, fraction, 0)
    assert len(validation) == held_out
    assert sorted([*training.tolist(), *validation.tolist()]) == list(range(episodes))


def test_modalities_are_selected_by_name(toy_root: Path, unbroken: tuple[Path, Path], tmp_path: Path) -> None:
    cache = unbroken[1]
    config = replace(SMALL, steps=1)
    both = train_representation(toy_root, config, tmp_path / "both", cache).modalities
    assert both.state_dims == (1, 2, 3) and list(both.cameras) == [
        "observation.images.front",
        "observation.images.wrist",
    ]
    fallback = train_representation(
        toy_root, replace(config, proprioception=["arm*"]), tmp_path / "all", cache
    ).modalities
    assert fallback.state_dims == (0, 1, 2, 3)
    wrist = replace(config, cameras=["observation.images.wrist"], proprioception=[])
    assert train_representation(toy_root, wrist, tmp_path / "wrist", cache).modalities.state_dims == ()
    with pytest.raises(DatasetError, match=r"Did you mean 'observation\.images\.wrist'"):
        train_representation(toy_root, replace(config, cameras=["observation.images.wirst"]), tmp_path, cache)
    with pytest.raises(DatasetError, match="at most 32"):
        train_representation(toy_root, replace(config, image_size=64), tmp_path, cache)


@pytest.mark.parametrize(
    "wrong",
    [
        {"cameras": [], "proprioception": []},
        {"image_size": 8},
        {"steps": 0},
        {"learning_rate": 0.0},
        {"validation_fraction": 1.0},
        {"device": "gpu"},
    ],
)
def test_impossible_settings_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ConfigError):
        RepresentationConfig(**wrong)  # type: ignore[arg-type]
