"""One small environment for all tests of this folder, and what episodes in it look like to the last bit."""

from collections.abc import Callable, Iterator
from hashlib import sha256
from typing import Any

import numpy as np
import pytest

from lerobot_buds.envs import EnvSettings, RobosuiteEnv

TASK = "multitask_kitchen/task3_variant1"


@pytest.fixture(scope="session")
def settings() -> EnvSettings:
    return EnvSettings(TASK, None, 16, "fastest")


@pytest.fixture(scope="session")
def env(settings: EnvSettings) -> Iterator[RobosuiteEnv]:
    env = RobosuiteEnv(settings)
    yield env
    env.close()


@pytest.fixture(scope="session")
def actions() -> np.ndarray:
    """Forty random actions at human speed."""
    return np.random.default_rng(7).uniform(-0.6, 0.6, (40, 4)).astype(np.float32)


@pytest.fixture(scope="session")
def digest() -> Callable[[Any], str]:
    """Hashes an observation, or any nest of dictionaries and arrays."""

    def digest(value: Any) -> str:
        if isinstance(value, dict):
            return sha256("".join(f"{key}{digest(value[key])}" for key in sorted(value)).encode()).hexdigest()
        return sha256(np.ascontiguousarray(value).tobytes()).hexdigest()

    return digest


@pytest.fixture(scope="session")
def trace(env: RobosuiteEnv, actions: np.ndarray, digest: Callable[[Any], str]) -> Callable[..., list[str]]:
    """Runs an episode from a seed; returns the hash of every observation."""

    def trace(seed: int, steps: int = 10) -> list[str]:
        observation, _ = env.reset(seed=seed)
        return [digest(observation), *(digest(env.step(action)[0]) for action in actions[:steps])]

    return trace
