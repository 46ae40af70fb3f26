from collections.abc import Callable

import numpy as np
import pytest

Demonstrations = tuple[list[np.ndarray], list[np.ndarray]]


@pytest.fixture(scope="session")
def demonstrations() -> Callable[..., Demonstrations]:
    """Makes latents of demonstrations that visit known stages, with their true labels."""

    def make(count: int = 6, stages: int = 3, dims: int = 8, seed: int = 0, noise: float = 0.3) -> Demonstrations:
        rng = np.random.default_rng(seed)
        centres = rng.normal(size=(stages + 1, dims)) * 3
        latents, truth = [], []
        for _ in range(count):
            lengths = rng.integers(40, 90, size=stages)
            stage = np.repeat(np.arange(stages), lengths)
            along = np.concatenate([np.linspace(0, 1, n, endpoint=False) for n in lengths])[:, None]
            path = centres[stage] + 0.3 * along * (centres[stage + 1] - centres[stage])
            latents.append(path + noise * rng.normal(size=path.shape))
            truth.append(stage.astype(np.int64))
        return latents, truth

    return make
