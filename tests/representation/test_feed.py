import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from lerobot_buds.data import LocalDataset
from lerobot_buds.representation import Modalities, RepresentationConfig, encode_dataset, feed, train_representation
from lerobot_buds.representation.feed import AHEAD, DEVICE_SHARE, Feed, fetched_ahead, fits
from lerobot_buds.representation.inputs import DatasetInputs
from lerobot_buds.representation.run import deterministic_convolutions
from lerobot_buds.representation.trained import RECORD_FILE, WEIGHTS_FILE

CPU = torch.device("cpu")
CONFIG = RepresentationConfig(
    image_size=16, latent_dim=4, steps=12, batch_size=8, checkpoint_interval=6, validation_fraction=0.25, device="cpu"
)
Batches = list[dict[str, torch.Tensor]]


@pytest.fixture(scope="module")
def inputs(toy_root: Path, tmp_path_factory: pytest.TempPathFactory) -> DatasetInputs:
    """The second and the last episode: rows 12 to 20 and 31 to 41."""
    chosen = LocalDataset(toy_root, chosen=(1, 3))
    return DatasetInputs(chosen, Modalities.select(chosen, CONFIG), 16, tmp_path_factory.mktemp("cache"))


@pytest.fixture
def roomy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Has frames kept on the device, which here is the CPU."""
    monkeypatch.setattr(feed, "fits", lambda needed, device: True)


def assert_same(ours: Batches, theirs: Batches) -> None:
    for mine, other in zip(ours, theirs, strict=True):
        assert list(mine) == list(other)
        for name in mine:
            assert torch.equal(mine[name], other[name]), name
            # Another layout could choose another algorithm, and so other roundings.
            assert not len(mine[name]) or mine[name].stride() == other[name].stride(), name


@pytest.fixture
def wanted(inputs: DatasetInputs) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [*(rng.permutation(inputs.rows)[:6] for _ in range(5)), inputs.rows, inputs.rows[:0]]


@pytest.mark.usefixtures("roomy")
@pytest.mark.parametrize("portion", [7, 256])
def test_frames_kept_on_the_device_give_the_same_batches(
    inputs: DatasetInputs, wanted: list[np.ndarray], monkeypatch: pytest.MonkeyPatch, portion: int
) -> None:
    monkeypatch.setattr(feed, "_PORTION", portion)
    kept = Feed(inputs, CPU, again=True)
    monkeypatch.setattr(inputs, "arrays", {})  # nothing is read any more
    fetched = list(kept.batches(wanted))
    monkeypatch.undo()
    assert_same(fetched, [inputs.batch(indices, CPU) for indices in wanted])


def test_frames_fetched_by_a_thread_give_the_same_batches(inputs: DatasetInputs, wanted: list[np.ndarray]) -> None:
    plain = Feed(inputs, CPU, again=False)
    ahead = [plain._upload(read) for read in fetched_ahead(plain._read, wanted)]
    assert_same(ahead, [inputs.batch(indices, CPU) for indices in wanted])
    assert_same(list(plain.batches(wanted)), ahead)


@pytest.mark.usefixtures("roomy")
def test_frames_that_are_read_once_are_not_kept(inputs: DatasetInputs, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(feed, "_moved", refuse)
    Feed(inputs, CPU, again=False)
    with pytest.raises(AssertionError):
        Feed(inputs, CPU, again=True)


def test_frames_fit_on_a_gpu_with_room_for_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (1000, 4000))
    limit = int(DEVICE_SHARE * 1000)
    assert fits(limit, torch.device("cuda")) and not fits(limit + 1, torch.device("cuda"))
    assert not fits(0, CPU)


def test_results_come_in_order_and_little_is_read_ahead() -> None:
    asked: list[int] = []

    def numbers() -> Iterator[int]:
        for number in range(10):
            asked.append(number)
            yield number

    results = fetched_ahead(lambda number: (number, threading.get_ident()), numbers())
    number, thread = next(results)
    assert number == 0 and thread != threading.get_ident() and len(asked) == AHEAD + 1
    assert [number for number, _ in results] == list(range(1, 10))


def test_an_error_is_raised_where_its_result_is_asked_for() -> None:
    results = fetched_ahead(lambda number: 6 // number, [3, 2, 0, 1])
    assert [next(results), next(results)] == [2, 3]
    with pytest.raises(ZeroDivisionError):
        next(results)


def test_the_thread_ends_with_whoever_asked() -> None:
    before = threading.active_count()
    results = fetched_ahead(str, range(10))
    next(results)
    assert threading.active_count() == before + 1
    del results
    assert threading.active_count() == before


def test_where_frames_lie_makes_no_difference(toy_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = train_representation(toy_root, CONFIG, tmp_path / "plain", tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(feed, "fits", lambda needed, device: True)
        kept = train_representation(toy_root, CONFIG, tmp_path / "kept", tmp_path)
    for name in (WEIGHTS_FILE, RECORD_FILE):
        assert (tmp_path / "plain" / name).read_bytes() == (tmp_path / "kept" / name).read_bytes()
    ours, theirs = (encode_dataset(toy_root, r, 8, tmp_path / str(i)) for i, r in enumerate((plain, kept)))
    np.testing.assert_array_equal(np.concatenate(ours), np.concatenate(theirs))


def test_a_training_set_smaller_than_a_batch_is_one_batch(toy_root: Path, tmp_path: Path) -> None:
    """Which a larger batch size cannot change."""
    hashes = set()
    for size in (1000, 2000):
        config = replace(CONFIG, steps=3, batch_size=size)
        train_representation(toy_root, config, tmp_path / str(size), tmp_path)
        hashes.add((tmp_path / str(size) / WEIGHTS_FILE).read_bytes())
    assert len(hashes) == 1


def test_convolutions_stay_in_cudnn() -> None:
    """`torch.backends.cudnn.flags` switches off what it is not told, the library itself included."""
    cudnn = torch.backends.cudnn
    before = (cudnn.enabled, cudnn.allow_tf32, cudnn.deterministic, cudnn.benchmark)
    with deterministic_convolutions():
        assert (cudnn.enabled, cudnn.allow_tf32) == before[:2]
        assert cudnn.deterministic and not cudnn.benchmark
    assert (cudnn.enabled, cudnn.allow_tf32, cudnn.deterministic, cudnn.benchmark) == before
