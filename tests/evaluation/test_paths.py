"""Distances of paths by dynamic time warping, against the plain recursion."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_buds.evaluation import warped_distances


def by_recursion(first, second):
    table = np.full((len(first) + 1, len(second) + 1), np.inf)
    table[0, 0] = 0
    for i, a in enumerate(first, 1):
        for j, b in enumerate(second, 1):
            table[i, j] = np.linalg.norm(a - b) + min(table[i - 1, j], table[i, j - 1], table[i - 1, j - 1])
    return table[-1, -1] / max(len(first), len(second))


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 9))
def test_it_equals_the_recursion_and_is_symmetric(seed, n, m):
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(n, 3)), rng.normal(size=(m, 3))
    there, back = warped_distances([(first, second), (second, first)])
    assert there == pytest.approx(by_recursion(first, second)) == pytest.approx(back)


def test_pace_does_not_matter_and_place_does():
    path = np.stack([np.linspace(0, 1, 11), np.zeros(11)], 1)
    slow = np.repeat(path, 3, axis=0)
    same, aside = warped_distances([(path, slow), (path, path + np.array([0.0, 0.2]))])
    assert same == 0
    assert aside == pytest.approx(0.2)
