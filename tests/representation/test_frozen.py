"""Frozen features: pooled as the model pools, reduced, scaled, and stored whole. All weights are random and tiny."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import timm
import torch
from huggingface_hub import constants
from safetensors.torch import save_file

from lerobot_buds.core import CheckpointError, ConfigError
from lerobot_buds.representation import (
    Modalities,
    Representation,
    RepresentationConfig,
    draw_reconstructions,
    encode_dataset,
    train_representation,
)
from lerobot_buds.representation.frozen import FrozenFeatures
from lerobot_buds.representation.network import PROPRIOCEPTION
from lerobot_buds.representation.trained import RECORD_FILE, WEIGHTS_FILE

FROZEN = RepresentationConfig(
    backbone="test_vit",
    backbone_weights="random",
    backbone_image_size=48,
    latent_dim=4,
    proprioception=["eef*", "gripper*"],
    validation_fraction=0.0,
    device="cpu",
)
CAMERA = "observation.images.front"


def frozen_of(config: RepresentationConfig = FROZEN, dims: int = 0) -> FrozenFeatures:
    names = tuple(f"joint_{i}" for i in range(dims))
    modalities = Modalities({CAMERA: (48, 48)}, names, tuple(range(dims)))
    network = Representation.untrained(modalities, config).network
    assert isinstance(network, FrozenFeatures)
    return network


def random_weights(path: Path, name: str = "test_vit", seed: int = 3) -> Path:
    torch.manual_seed(seed)
    save_file(timm.create_model(name).state_dict(), path)
    return path


@pytest.fixture(scope="module")
def trained(toy_root: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Representation, Path]:
    folder = tmp_path_factory.mktemp("frozen")
    return train_representation(toy_root, FROZEN, folder / "run", folder / "cache"), folder


def test_every_camera_counts_alike_and_proprioception_by_its_weight(
    toy_root: Path, trained: tuple[Representation, Path]
) -> None:
    """Two cameras of four components and three joints, one of which never moves."""
    representation, folder = trained
    latents = np.concatenate(encode_dataset(toy_root, representation, 8, folder / "cache"))
    assert latents.shape == (42, 11)
    variance = latents.var(axis=0)
    for part, expected in ((variance[:4], 1), (variance[4:8], 1), (variance[8:], 2 * 4.0**2)):
        assert part.sum() == pytest.approx(expected, rel=0.03)  # PCA divides by one frame less
    assert np.all(np.diff(variance[:4]) <= 0) and np.all(np.diff(variance[4:8]) <= 0)
    np.testing.assert_allclose(variance[8:], [16, 16, 0], rtol=1e-5)
    np.testing.assert_allclose(latents.mean(axis=0), 0, atol=1e-4)


@pytest.mark.parametrize("name", ["test_vit", "test_resnet"])
def test_pooling_is_the_models_own_and_sees_every_corner(name: str) -> None:
    network = frozen_of(replace(FROZEN, backbone=name))
    images = torch.rand(2, 3, 48, 48, generator=torch.Generator().manual_seed(0))
    (pooled,) = network.features({CAMERA: images})
    config = timm.data.resolve_model_data_config(network.backbone)
    mean, std = (torch.tensor(config[key])[:, None, None] for key in ("mean", "std"))
    places = network.backbone.forward_features((images - mean) / std)
    expected = places[:, 0] if name == "test_vit" else places.mean(dim=(2, 3))
    torch.testing.assert_close(pooled, expected, rtol=1e-4, atol=1e-5)
    for corner in (slice(0, 16), slice(32, 48)):
        changed = images.clone()
        changed[:, :, corner, corner] = 1 - changed[:, :, corner, corner]
        assert (network.features({CAMERA: changed})[0] - pooled).abs().amax(dim=1).min() > 1e-3


def test_frames_are_resized_as_pictures_are() -> None:
    """A smooth picture at another size has nearly the same feature; one of noise has not."""
    network = frozen_of()
    ramp = torch.linspace(0, 1, 96)[None, None, :, None].expand(1, 3, 96, 96)
    small = torch.nn.functional.interpolate(ramp, size=(30, 40), mode="area")
    large, other = network.features({CAMERA: ramp})[0], network.features({CAMERA: small})[0]
    noise = network.features({CAMERA: torch.rand(1, 3, 96, 96)})[0]
    assert (large - other).norm() < 0.1 * (large - noise).norm()


def test_what_is_saved_is_whole(
    toy_root: Path, trained: tuple[Representation, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    representation, folder = trained
    again = train_representation(toy_root, FROZEN, tmp_path / "again", folder / "cache")
    for name in (RECORD_FILE, WEIGHTS_FILE):
        assert (tmp_path / "again" / name).read_bytes() == (folder / "run" / name).read_bytes()
    loaded = Representation.from_pretrained(folder / "run")
    assert loaded.hash == representation.hash == again.hash
    with monkeypatch.context() as patch:
        patch.setattr(FrozenFeatures, "fit", None)
        assert train_representation(toy_root, FROZEN, folder / "run", folder / "cache").hash == loaded.hash
    ours = encode_dataset(toy_root, representation, 8, tmp_path / "a")
    theirs = encode_dataset(toy_root, loaded, 8, tmp_path / "b")
    np.testing.assert_array_equal(np.concatenate(ours), np.concatenate(theirs))
    other = train_representation(toy_root, replace(FROZEN, seed=1), tmp_path / "other", folder / "cache")
    assert other.hash != loaded.hash
    assert not loaded.draws
    with pytest.raises(ConfigError, match="reconstructs no images"):
        draw_reconstructions(toy_root, loaded, tmp_path / "picture.png", cache_dir=folder / "cache")


@pytest.mark.parametrize("source", ["file", "hub"])
def test_weights_come_from_a_file_or_from_the_cache_of_the_hub(
    source: str, toy_root: Path, trained: tuple[Representation, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At another image size than the published one, which the positions of a transformer have to be resampled for."""
    snapshot = tmp_path / "models--timm--test_vit.r160_in1k/snapshots/0123"
    snapshot.mkdir(parents=True)
    (snapshot.parents[1] / "refs").mkdir()
    (snapshot.parents[1] / "refs/main").write_text("0123")
    path = random_weights(snapshot / "model.safetensors")
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path))
    weights = str(path) if source == "file" else "pretrained"
    cache = trained[1] / "cache"
    network = train_representation(toy_root, replace(FROZEN, backbone_weights=weights), tmp_path / "run", cache).network
    torch.manual_seed(3)
    published = timm.create_model("test_vit").state_dict()
    state = network.backbone.state_dict()
    for name in ("patch_embed.proj.weight", "blocks.0.attn.qkv.weight", "norm.weight"):
        assert torch.equal(state[name], published[name])
    assert state["pos_embed"].shape[1] == 1 + 3 * 3 and published["pos_embed"].shape[1] == 1 + 10 * 10


@pytest.mark.parametrize(
    ("changes", "error", "said"),
    [
        ({"backbone_weights": "absent.safetensors"}, CheckpointError, "absent.safetensors holds no weights"),
        ({"backbone_weights": "damaged.safetensors"}, CheckpointError, "damaged.safetensors holds no weights"),
        ({"backbone_weights": "other.safetensors"}, ConfigError, "cannot be built for images of 48 pixels"),
        ({"backbone_weights": "pretrained"}, CheckpointError, "'timm/test_vit.r160_in1k' is not on this machine"),
        ({"backbone_weights": "pretrained"}, CheckpointError, "Or set backbone_weights to a .safetensors file"),
        ({"backbone": "vit_base_patch14_dinov4"}, ConfigError, "Did you mean 'vit_base_patch14_dinov2'"),
        ({"backbone": "test_vit.nobody"}, ConfigError, "nobody"),
        ({"backbone": "hf-hub:someone/model"}, ConfigError, "has no model 'hf-hub:someone/model'"),
        ({"backbone_image_size": 50}, ConfigError, "50 pixels"),
        ({"latent_dim": 50}, ConfigError, "from 42 training frames of 64 channels"),
    ],
)
def test_what_cannot_work_is_said(
    changes: dict[str, object],
    error: type[Exception],
    said: str,
    toy_root: Path,
    trained: tuple[Representation, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    random_weights(Path("other.safetensors"), "test_resnet")
    Path("damaged.safetensors").write_bytes(b"\xff" * 64)
    with pytest.raises(error) as raised:
        train_representation(toy_root, replace(FROZEN, **changes), tmp_path / "run", trained[1] / "cache")
    assert said in str(raised.value) and not (tmp_path / "run").exists()


def test_without_timm_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "timm", None)
    with pytest.raises(ConfigError, match=r"pip install 'lerobot_policy_buds\[timm\]'"):
        frozen_of()


def test_a_black_camera_and_a_still_robot_stay_finite() -> None:
    network = frozen_of(dims=2)
    batch = {CAMERA: torch.zeros(6, 3, 48, 48), PROPRIOCEPTION: torch.ones(6, 2)}
    network.fit([batch])
    latents = network.latents(batch)
    assert latents.shape == (6, 6) and (latents == 0).all()
