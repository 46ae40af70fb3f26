import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from PIL import Image
from safetensors.torch import load_file, save_file

from lerobot_buds.core import STATE, CheckpointError, DatasetError, read_json, sha256_of_file, write_json
from lerobot_buds.data import cached_frames, read_table
from lerobot_buds.representation import (
    Modalities,
    Representation,
    RepresentationConfig,
    draw_reconstructions,
    encode_dataset,
    encode_observations,
    train_representation,
)
from lerobot_buds.representation.inputs import DatasetInputs
from lerobot_buds.representation.trained import RECORD_FILE, WEIGHTS_FILE

CONFIG = RepresentationConfig(image_size=16, latent_dim=4, device="cpu")


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="session")
def representation(toy_root: Path) -> Representation:
    return Representation.untrained(Modalities.select(toy_root, CONFIG), CONFIG)


def test_latents_are_posterior_means_episode_by_episode(
    toy_root: Path, representation: Representation, cache: Path
) -> None:
    dims = len(representation.modalities.state_dims)
    latents = encode_dataset(toy_root, representation, 8, cache)
    assert [len(h) for h in latents] == [12, 9, 10, 11]
    assert all(h.dtype == np.float64 and h.shape[1] == 4 + dims for h in latents)
    inputs = DatasetInputs(toy_root, representation.modalities, 16, cache)
    with torch.no_grad():
        one = representation.network.encode(inputs.batch(np.array([15]), torch.device("cpu"))).mean
    np.testing.assert_allclose(latents[1][3][:4], one[0].numpy(), rtol=1e-4, atol=1e-6)


@pytest.fixture
def observations(toy_root: Path, representation: Representation, cache: Path) -> dict[str, np.ndarray]:
    """All frames of the dataset, as an environment would hand them over, with a camera that nobody asked for."""
    cameras = {name: np.array(cached_frames(toy_root, name, cache)) for name in representation.modalities.cameras}
    state = read_table(toy_root, [STATE]).columns[STATE]
    return {**cameras, STATE: state, "observation.images.other": np.zeros((42, 3, 5, 5), dtype=np.uint8)}


def test_an_observation_has_the_latent_that_the_dataset_gives_it(
    toy_root: Path, representation: Representation, cache: Path, observations: dict[str, np.ndarray]
) -> None:
    latents = np.concatenate(encode_dataset(toy_root, representation, 8, cache))
    batch = {name: rows[8:16] for name, rows in observations.items()}
    np.testing.assert_array_equal(encode_observations(representation, batch), latents[8:16])
    for t in (0, 13, 41):  # alone: other kernels, another order of the sums
        one = encode_observations(representation, {name: rows[t : t + 1] for name, rows in observations.items()})
        np.testing.assert_allclose(one[0], latents[t], rtol=1e-4, atol=1e-5)


def test_an_observation_of_another_size_is_refused(
    representation: Representation, observations: dict[str, np.ndarray]
) -> None:
    camera = next(iter(representation.modalities.cameras))
    for name, wrong in ((camera, observations[camera][:, :, :16]), (STATE, observations[STATE][:, :2])):
        with pytest.raises(CheckpointError, match=name):
            encode_observations(representation, observations | {name: wrong})
    del observations[camera]
    with pytest.raises(CheckpointError, match="has None"):
        encode_observations(representation, observations)


@pytest.mark.parametrize("weight", [0.0, 1.0, 3.0])
def test_proprioception_counts_by_its_weight(toy_root: Path, cache: Path, tmp_path: Path, weight: float) -> None:
    config = replace(CONFIG, steps=1, proprioception_weight=weight, validation_fraction=0.0)
    trained = train_representation(toy_root, config, tmp_path, cache)
    latents = np.concatenate(encode_dataset(toy_root, trained, 8, tmp_path))
    fused, beside = latents[:, :4], latents[:, 4:]
    assert beside.shape[1] == (len(trained.modalities.state_dims) if weight else 0)
    assert fused.var(axis=0).sum() == pytest.approx(1, rel=1e-3)
    assert beside.var(axis=0).sum() == pytest.approx(weight**2, rel=1e-3)


def test_weights_of_the_first_version_give_the_fused_latent_alone(
    toy_root: Path, representation: Representation, tmp_path: Path
) -> None:
    representation.save(tmp_path)
    state = load_file(tmp_path / WEIGHTS_FILE)
    del state["latent_scale"], state["proprioception_scale"]
    save_file(state, tmp_path / WEIGHTS_FILE)
    record = read_json(tmp_path / RECORD_FILE)
    del record["config"]["proprioception_weight"]
    record |= {"version": 1, "weights_sha256": sha256_of_file(tmp_path / WEIGHTS_FILE)}
    write_json(tmp_path / RECORD_FILE, record)
    latents = encode_dataset(toy_root, Representation.load(tmp_path), 8, tmp_path / "cache")
    assert latents[0].shape[1] == 4


def test_latents_are_computed_once(toy_root: Path, representation: Representation, tmp_path: Path) -> None:
    first = encode_dataset(toy_root, representation, 8, tmp_path)
    stored = next(tmp_path.glob("latents-*.npy"))
    before = stored.stat().st_mtime_ns
    second = encode_dataset(toy_root, representation, 8, tmp_path)
    assert stored.stat().st_mtime_ns == before
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(second))
    other = Representation.untrained(representation.modalities, replace(CONFIG, seed=1))
    encode_dataset(toy_root, other, 8, tmp_path)
    assert len(list(tmp_path.glob("latents-*.npy"))) == 2


def test_images_are_box_averages(toy_root: Path, representation: Representation, cache: Path) -> None:
    batch = DatasetInputs(toy_root, representation.modalities, 16, cache).batch(np.array([3, 20]), torch.device("cpu"))
    for name in representation.modalities.cameras:
        stored = cached_frames(toy_root, name, cache)[[3, 20]].astype(np.float64) / 255
        boxes = stored.reshape(2, 3, 16, 2, 16, 2).mean(axis=(3, 5))
        np.testing.assert_allclose(batch[name].numpy(), boxes, atol=0.5 / 255 + 1e-6)
        np.testing.assert_allclose(batch[name].numpy() * 255, (batch[name].numpy() * 255).round(), atol=1e-4)


def test_save_and_load_is_the_identity(toy_root: Path, representation: Representation, tmp_path: Path) -> None:
    representation.save(tmp_path)
    loaded = Representation.load(tmp_path)
    assert loaded.hash == representation.hash
    assert (loaded.modalities, loaded.config) == (representation.modalities, representation.config)
    ours = encode_dataset(toy_root, representation, 8, tmp_path / "a")
    theirs = encode_dataset(toy_root, loaded, 8, tmp_path / "b")
    np.testing.assert_array_equal(np.concatenate(ours), np.concatenate(theirs))


def test_damaged_newer_and_absent_files_are_refused(representation: Representation, tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="no whole representation"):
        Representation.load(tmp_path)
    representation.save(tmp_path)
    weights = (tmp_path / WEIGHTS_FILE).read_bytes()
    (tmp_path / WEIGHTS_FILE).write_bytes(weights[:-8])
    with pytest.raises(CheckpointError, match="is not the file"):
        Representation.load(tmp_path)
    (tmp_path / WEIGHTS_FILE).write_bytes(weights)
    record = json.loads((tmp_path / RECORD_FILE).read_text())
    (tmp_path / RECORD_FILE).write_text(json.dumps({**record, "version": 99, "package_version": "0.9.1"}))
    with pytest.raises(CheckpointError, match=r"has format 99.*Install lerobot_policy_buds>=0\.9\.1"):
        Representation.load(tmp_path)
    for damaged in ([record], {**record, "modalities": 3}, {**record, "config": {"depth": 3}}, {"version": 1}):
        (tmp_path / RECORD_FILE).write_text(json.dumps(damaged))
        with pytest.raises(CheckpointError, match=r"is damaged .*remove the folder and train it again"):
            Representation.load(tmp_path)


def test_an_older_record_is_read(representation: Representation, tmp_path: Path) -> None:
    """What an older version did not write keeps its default."""
    representation.save(tmp_path)
    record = json.loads((tmp_path / RECORD_FILE).read_text())
    del record["package_version"], record["config"]["checkpoint_interval"]
    (tmp_path / RECORD_FILE).write_text(json.dumps({**record, "version": 0}))
    assert Representation.load(tmp_path).hash == representation.hash


def test_what_an_older_version_wrote_is_read_and_what_is_no_record_is_not(
    representation: Representation, tmp_path: Path
) -> None:
    representation.save(tmp_path)
    record = json.loads((tmp_path / RECORD_FILE).read_text())
    first = {"image_size": 16, "latent_dim": 4, "device": "cpu"}  # as far as it differs from the defaults
    (tmp_path / RECORD_FILE).write_text(json.dumps({**record, "version": 1, "config": first}))
    assert Representation.load(tmp_path).config == replace(representation.config, proprioception_weight=0.0)
    for wrong in ([], {**record, "config": {"colour": 3}}, {**record, "config": {"image_size": 1}}, {"version": 2}):
        (tmp_path / RECORD_FILE).write_text(json.dumps(wrong))
        with pytest.raises(CheckpointError, match="is damaged"):
            Representation.load(tmp_path)


def test_other_frame_sizes_and_states_are_refused(toy_root: Path, representation: Representation, cache: Path) -> None:
    sizes = dict.fromkeys(representation.modalities.cameras, (64, 48))
    larger = replace(representation, modalities=replace(representation.modalities, cameras=sizes))
    with pytest.raises(CheckpointError, match=r"64 x 48 pixels.* 32 x 32"):
        encode_dataset(toy_root, larger, 8, cache)
    renamed = replace(representation, modalities=replace(representation.modalities, state_names=("a", "b", "c", "d")))
    with pytest.raises(CheckpointError, match="joint_1"):
        encode_dataset(toy_root, renamed, 8, cache)


def test_latents_that_are_not_finite_are_refused(toy_root: Path, cache: Path) -> None:
    broken = Representation.untrained(Modalities.select(toy_root, CONFIG), CONFIG)
    with torch.no_grad():
        broken.network.proprioception_encoder.layers[0].weight.fill_(torch.nan)
    with pytest.raises(DatasetError, match="latent of episode 0, frame 0, dimension 0 is nan, and 41 more frame"):
        encode_dataset(toy_root, broken, 8, cache)


def test_partial_downloads_are_refused(toy_root: Path, representation: Representation, tmp_path: Path) -> None:
    root = Path(shutil.copytree(toy_root, tmp_path / "partial"))
    shard = next((root / "data").rglob("*.parquet"))
    pq.write_table(pq.read_table(shard).slice(0, 30), shard)
    with pytest.raises(DatasetError, match="12 of 42 rows are not on this machine, the first is episode 2, frame 9"):
        encode_dataset(root, representation, 8, tmp_path / "cache")


def test_picture_of_reconstructions(
    toy_root: Path, representation: Representation, cache: Path, tmp_path: Path
) -> None:
    draw_reconstructions(toy_root, representation, tmp_path / "picture.png", columns=4, cache_dir=cache)
    assert min(Image.open(tmp_path / "picture.png").size) > 200
