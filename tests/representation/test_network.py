import pytest
import torch
from torch import Tensor, nn

from lerobot_buds.representation.network import (
    PROPRIOCEPTION,
    FusionNetwork,
    Gaussian,
    ImageDecoder,
    ImageEncoder,
    ProprioceptionDecoder,
    ProprioceptionEncoder,
    kl_to_prior,
    product_of_experts,
)


def parameters_of(module: nn.Module) -> int:
    return sum(p.numel() for p in module.parameters())


def batch_of(size: int = 32, dims: int = 5, seed: int = 0) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    images = {name: torch.rand(4, 3, size, size, generator=generator) for name in ("workspace", "wrist")}
    return {**images, PROPRIOCEPTION: torch.rand(4, dims, generator=generator)}


def test_parameter_counts_are_those_of_the_released_code() -> None:
    assert parameters_of(ImageEncoder(128, 32)) == 222_400
    assert parameters_of(ImageDecoder(128, 32)) == 151_104
    assert parameters_of(ProprioceptionEncoder(5, 32)) == 83_776
    assert parameters_of(ProprioceptionDecoder(5, 32)) == 21_381


@pytest.mark.parametrize("size", [16, 48, 64, 84, 96, 100, 128])
def test_every_image_size_is_encoded_and_restored(size: int) -> None:
    posterior = ImageEncoder(size, 8)(torch.rand(2, 3, size, size))
    assert posterior.mean.shape == posterior.variance.shape == (2, 8)
    image = ImageDecoder(size, 8)(posterior.mean)
    assert image.shape == (2, 3, size, size) and image.min() >= 0 and image.max() <= 1


def test_product_of_experts_is_the_product_of_gaussians() -> None:
    """Compares with densities multiplied on a fine grid, prior included."""
    generator = torch.Generator().manual_seed(1)
    mean = torch.randn(3, 6, 4, generator=generator, dtype=torch.float64)
    variance = torch.rand(3, 6, 4, generator=generator, dtype=torch.float64) + 0.05
    fused = product_of_experts([Gaussian(m, v) for m, v in zip(mean, variance, strict=True)])
    grid = torch.linspace(-12, 12, 20_001, dtype=torch.float64)[:, None, None]
    log_density = -0.5 * grid**2
    for m, v in zip(mean, variance, strict=True):
        log_density = log_density - 0.5 * (grid - m) ** 2 / v
    density = torch.softmax(log_density, dim=0)
    grid_mean = (density * grid).sum(0)
    torch.testing.assert_close(fused.mean, grid_mean, rtol=0, atol=1e-9)
    torch.testing.assert_close(fused.variance, (density * (grid - grid_mean) ** 2).sum(0), rtol=1e-9, atol=1e-9)


def test_kl_equals_that_of_torch() -> None:
    generator = torch.Generator().manual_seed(2)
    mean, variance = torch.randn(5, 4, generator=generator), torch.rand(5, 4, generator=generator) + 0.1
    normal = torch.distributions.Normal
    theirs = torch.distributions.kl_divergence(normal(mean, variance.sqrt()), normal(0.0, 1.0)).sum(1)
    torch.testing.assert_close(kl_to_prior(Gaussian(mean, variance)), theirs)


@pytest.mark.parametrize("changed", ["workspace", "wrist", PROPRIOCEPTION])
def test_every_modality_moves_the_latent_and_learns(changed: str) -> None:
    torch.manual_seed(0)
    network = FusionNetwork(["workspace", "wrist"], 5, 32, 8)
    batch = batch_of()
    before = network.encode(batch).mean
    after = network.encode({**batch, changed: batch_of(seed=1)[changed]}).mean
    assert (before != after).any(dim=1).all()
    network(batch, torch.zeros(4, 8), 0.05)["loss"].backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in network.parameters())


@pytest.mark.parametrize(
    ("cameras", "dims", "terms"),
    [(["wrist"], 0, {"wrist"}), ([], 5, {PROPRIOCEPTION}), (["workspace"], 5, {"workspace", PROPRIOCEPTION})],
)
def test_subsets_of_modalities(cameras: list[str], dims: int, terms: set[str]) -> None:
    network = FusionNetwork(cameras, dims, 32, 8)
    losses = network(batch_of(), torch.zeros(4, 8), 0.05)
    assert set(losses) == terms | {"kl", "loss"}
    expected = sum(losses[name] for name in terms) + 0.05 * losses["kl"]
    torch.testing.assert_close(losses["loss"], expected)


def test_image_errors_are_sums_at_the_reference_size() -> None:
    network = FusionNetwork(["wrist"], 0, 32, 8)
    batch = batch_of()
    decoded = network.decode(network.encode(batch).mean)["wrist"]
    at_128 = nn.functional.interpolate(decoded - batch["wrist"], scale_factor=4).square().sum() / 4
    torch.testing.assert_close(network(batch, torch.zeros(4, 8), 0.0)["wrist"], at_128)


def test_fusion_and_loss_stay_in_float32_under_mixed_precision() -> None:
    torch.manual_seed(0)
    network, batch = FusionNetwork(["workspace", "wrist"], 5, 32, 8), batch_of()
    exact = network(batch, torch.zeros(4, 8), 0.05)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert network.image_encoders[0].head(torch.zeros(1, 8 * 2 * 2)).dtype == torch.bfloat16
        posterior = network.encode(batch)
        terms = network(batch, torch.zeros(4, 8), 0.05)
    assert posterior.mean.dtype == posterior.variance.dtype == torch.float32
    assert all(term.dtype == torch.float32 for term in terms.values())
    torch.testing.assert_close(terms["loss"], exact["loss"], rtol=0.02, atol=0)
    assert terms["loss"] != exact["loss"]
