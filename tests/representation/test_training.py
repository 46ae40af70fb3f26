import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from lerobot_buds.core import ConfigError, DatasetError
from lerobot_buds.representation import (
    Modalities,
    Representation,
    RepresentationConfig,
    encode_dataset,
    train_representation,
    trained,
)
from lerobot_buds.representation.reports import kept_report, out_of_patience
from lerobot_buds.representation.run import CHECKPOINT_FILE, TrainingRun
from lerobot_buds.representation.trained import RECORD_FILE, WEIGHTS_FILE
from lerobot_buds.representation.training import split_episodes

pytestmark = pytest.mark.slow

SMALL = RepresentationConfig(
    proprioception=["eef*", "gripper*"],
    image_size=16,
    latent_dim=4,
    steps=30,
    batch_size=16,
    checkpoint_interval=10,
    validation_fraction=0.25,
    device="cpu",
)


# What several processes, or another precision, need a process of their own for.
SCRIPT = Path(__file__).with_name("train_once.py")
PROCESS = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}


class Killed(Exception):
    """Stands for a kill between two steps."""


def raise_killed(*_: object) -> None:
    raise Killed


def bytes_of(folder: Path) -> tuple[bytes, bytes]:
    return (folder / WEIGHTS_FILE).read_bytes(), (folder / RECORD_FILE).read_bytes()


def train_until_killed(
    monkeypatch: pytest.MonkeyPatch, root: Path, config: RepresentationConfig, run: Path, cache: Path, before: int = 25
) -> None:
    """Dies before a step; before step 25 it is after the checkpoint of step 20."""
    whole_step = TrainingRun.step

    def step_or_die(self: TrainingRun, step: int) -> None:
        if step == before:
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


def test_training_ends_without_progress_and_keeps_the_best(
    toy_root: Path, unbroken: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = unbroken[1]
    # So fast that held-out episodes soon suffer.
    config = replace(SMALL, steps=100, learning_rate=0.03, checkpoint_interval=1, patience=3)
    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(Representation, "save", raise_killed)
        train_representation(toy_root, config, tmp_path / "run", cache)
    # All that is left is to end: the decision follows from the checkpoint.
    with monkeypatch.context() as patch:
        patch.setattr(TrainingRun, "step", raise_killed)
        ended = train_representation(toy_root, config, tmp_path / "run", cache)
    validation = [report["validation/loss"] for report in ended.losses]
    assert len(validation) < 100 and len(validation) - 1 - int(np.argmin(validation)) == 3
    # The same run, cut off one step after the lowest: its checkpoint has the network that was kept.
    best = int(np.argmin(validation))
    train_until_killed(monkeypatch, toy_root, config, tmp_path / "cut", cache, before=best + 1)
    stored = load_file(tmp_path / "cut" / CHECKPOINT_FILE)
    for name, tensor in ended.network.named_parameters():
        assert torch.equal(tensor, stored[f"network/{name}"]), name


def test_early_stopping_survives_a_kill(
    toy_root: Path, unbroken: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = unbroken[1]
    config = replace(SMALL, steps=100, learning_rate=0.02, checkpoint_interval=2, patience=4)
    whole = train_representation(toy_root, config, tmp_path / "whole", cache)
    last = int(whole.losses[-1]["step"])
    assert 10 < last < 100
    train_until_killed(monkeypatch, toy_root, config, tmp_path / "run", cache, before=last - 1)
    train_representation(toy_root, config, tmp_path / "run", cache)
    assert bytes_of(tmp_path / "whole") == bytes_of(tmp_path / "run")


def test_reports_tell_what_is_kept_and_when_to_end() -> None:
    losses = [{"validation/loss": value} for value in (5.0, 3.0, 4.0, 3.0, 6.0)]
    assert [kept_report(losses[:n]) for n in range(1, 6)] == [0, 1, 1, 1, 1]
    assert [out_of_patience(losses[:n], 3) for n in range(6)] == [False] * 5 + [True]
    assert not out_of_patience(losses, 0) and not out_of_patience(losses, 4)
    unseen = [{"training/loss": value} for value in (1.0, 2.0, 3.0)]
    assert kept_report(unseen) == 2 and not out_of_patience(unseen, 1)


def test_two_processes_train_what_one_trains(toy_root: Path, unbroken: tuple[Path, Path], tmp_path: Path) -> None:
    """Batches of 15 are shared as 8 and 7 frames, and the 12 held-out frames in the same way."""
    cache = unbroken[1]
    config = replace(SMALL, batch_size=15)
    alone = train_representation(toy_root, config, tmp_path / "one", cache)
    launch = ["-m", "accelerate.commands.launch", "--multi_gpu", "--num_processes=2", "--main_process_port=0"]
    arguments = [str(SCRIPT), str(toy_root), str(tmp_path / "two"), str(cache), json.dumps(asdict(config))]
    run = subprocess.run(
        [sys.executable, *launch, *arguments], capture_output=True, text=True, env=PROCESS, timeout=120
    )
    assert run.returncode == 0, run.stderr[-3000:]
    together = Representation.load(tmp_path / "two")
    said = [line for line in run.stdout.splitlines() if line.startswith("trained")]
    assert sorted(said) == [f"trained {rank} of 2: {together.hash}" for rank in (0, 1)]
    assert [r["step"] for r in together.losses] == [10, 20, 30]
    for ours, theirs in zip(together.losses, alone.losses, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-4)
    assert sorted(p.name for p in (tmp_path / "two").iterdir()) == [RECORD_FILE, WEIGHTS_FILE]
    # 42 frames in batches of 8, shared out; all have the latents that one process makes.
    latents = np.concatenate(encode_dataset(toy_root, together, 8, tmp_path / "alone"))
    same = sha256(latents.tobytes()).hexdigest()
    encoded = [line for line in run.stdout.splitlines() if line.startswith("encoded")]
    assert encoded == 2 * [f"encoded 3 batches of {same}"]


def test_bfloat16_trains_to_nearly_the_same(toy_root: Path, unbroken: tuple[Path, Path], tmp_path: Path) -> None:
    """In a process of its own: accelerate keeps one precision for each, which another run is told."""
    run, cache = unbroken
    config = replace(SMALL, mixed_precision="bf16")
    with pytest.raises(ConfigError, match="start another"):
        train_representation(toy_root, config, tmp_path, cache)
    arguments = [str(SCRIPT), str(toy_root), str(tmp_path / "half"), str(cache), json.dumps(asdict(config))]
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, env=PROCESS, timeout=120)
    assert done.returncode == 0, done.stderr[-3000:]
    half, whole = Representation.load(tmp_path / "half"), Representation.load(run)
    assert half.hash != whole.hash
    assert half.losses[-1] == pytest.approx(whole.losses[-1], rel=0.05)
    assert all(tensor.dtype == torch.float32 for tensor in half.network.state_dict().values())


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
    both = train_representation(toy_root, replace(config, proprioception=None), tmp_path / "both", cache).modalities
    assert both.state_dims == (0, 1, 2, 3) and list(both.cameras) == [
        "observation.images.front",
        "observation.images.wrist",
    ]
    assert train_representation(toy_root, config, tmp_path / "named", cache).modalities.state_dims == (1, 2, 3)
    with pytest.raises(ConfigError, match=r"'arm\*' matches no dimension of the state\. Known: 'eef_x"):
        train_representation(toy_root, replace(config, proprioception=["eef*", "arm*"]), tmp_path / "no", cache)
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
        {"patience": -1},
        {"mixed_precision": "fp16"},
        {"backbone": "resnet18", "cameras": []},
        {"backbone": "resnet18", "backbone_weights": "resnet18.pth"},
    ],
)
def test_impossible_settings_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ConfigError):
        RepresentationConfig(**wrong)  # type: ignore[arg-type]


def test_threads_do_not_mix_what_belongs_to_the_process(toy_root: Path, tmp_path: Path) -> None:
    """Weights are drawn from PyTorch's own generator, and cuDNN's flags are set, for one thread at a time."""
    small, deterministic = replace(SMALL, steps=5), torch.backends.cudnn.deterministic
    modalities = Modalities.select(toy_root, small)

    def train(number: int) -> str:
        return train_representation(toy_root, replace(small, steps=3 + 3 * number), tmp_path / str(number)).hash

    def draw(seed: int) -> str:
        return Representation.untrained(modalities, replace(small, seed=seed)).hash

    alone, before = [draw(seed) for seed in range(8)], torch.get_rng_state()
    with ThreadPoolExecutor(4) as threads:
        trained_together = threads.map(train, range(2))
        assert list(threads.map(draw, range(8))) == alone
        assert len(set(trained_together)) == 2
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.backends.cudnn.deterministic == deterministic


def test_drawing_weights_leaves_the_accelerators_generators_alone(
    toy_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch, "manual_seed", raise_killed)
    Representation.untrained(Modalities.select(toy_root, SMALL), SMALL)
