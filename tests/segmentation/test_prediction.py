"""The baseline that cuts where the future surprises: by hand, and where movements are known to change."""

import numpy as np
import pytest

from lerobot_buds.segmentation.cuts import CUTS
from lerobot_buds.segmentation.prediction import prediction_errors, surprising_moments


def zigzag(lengths=(60, 80, 50), noise=0.01, seed=0):
    """Straight legs at constant speed that turn at known frames, and these frames."""
    rng = np.random.default_rng(seed)
    ways = rng.normal(size=(len(lengths), 4))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    path = np.repeat(ways, lengths, axis=0).cumsum(axis=0) * 0.05
    return path + noise * rng.normal(size=path.shape), np.cumsum(lengths)[:-1]


@pytest.mark.parametrize("seed", range(3))
def test_turns_surprise_and_steady_movement_does_not(seed):
    lengths = [(60, 80, 50), (90, 70), (50, 60, 70), (160,)] * 5
    many = [zigzag(each, seed=100 * seed + i) for i, each in enumerate(lengths)]
    errors = prediction_errors([path for path, _ in many], step=10)
    found = surprising_moments(errors, 20, 5.0, threshold=3.0)
    for spans, (_, turns) in zip(found, many, strict=True):
        assert len(spans) == 1 + len(turns)
        assert len(turns) == 0 or np.abs(spans[1:, 0] - turns).max() <= 3


def test_a_surprise_is_told_where_it_happens():
    path = np.concatenate([np.linspace(0, 1, 50), np.linspace(1, 0, 50)])[:, None]
    (errors,) = prediction_errors([path], step=4)
    assert errors.shape == (100,) and 48 <= errors.argmax() <= 51
    assert surprising_moments([errors], 10, 1.0)[0].tolist() == [[0, 50], [50, 100]]


def test_what_is_shorter_than_two_steps_has_no_future():
    errors = prediction_errors([np.random.default_rng(0).normal(size=(n, 2)) for n in (0, 8, 30)], step=4)
    assert [len(e) for e in errors] == [0, 8, 30]
    assert not errors[1].any() and errors[2].all()
    assert surprising_moments(errors[:1], 5, 1.0)[0].shape == (0, 2)


def test_the_scale_of_a_dimension_changes_nothing():
    path, _ = zigzag()
    one, other = (CUTS["prediction error"]([path * scale], 20) for scale in (1.0, np.array([1e3, 1.0, 1e-3, 1.0])))
    assert one[0].tolist() == other[0].tolist()
