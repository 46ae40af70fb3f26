"""How far paths lie apart, whatever the pace at which they are walked: dynamic time warping."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

Path = NDArray[np.float64]


def warped_distances(pairs: Sequence[tuple[Path, Path]]) -> NDArray[np.float64]:
    """Computes the dynamic-time-warping distance of each pair of paths.

    The best alignment minimises the sum of distances between aligned points; the result is that sum over the length of
    the longer path, so that it reads as a distance and does not grow with the number of points (ours).

    Args:
        pairs: Two paths each, of shapes ``(n, D)`` and ``(m, D)``, n and m at least 1.

    Returns:
        (len(pairs),) float64, in the paths' unit.
    """
    return np.array([_warped_distance(first, second) for first, second in pairs])


def _warped_distance(first: Path, second: Path) -> float:
    """Fills the table of best sums one anti-diagonal at a time: its cells depend on the two before it only."""
    n, m = len(first), len(second)
    cost = np.full((n + 1, m + 1), np.inf)
    cost[1:, 1:] = cdist(first, second)
    cost[0, 0] = 0.0
    before, last = np.full(n + 1, np.inf), np.full(n + 1, np.inf)  # indexed by row
    last[0] = 0.0
    for diagonal in range(1, n + m + 1):
        rows = np.arange(max(0, diagonal - m), min(n, diagonal) + 1)
        inner = rows[rows > 0]
        current = np.full(n + 1, np.inf)
        best = np.minimum(np.minimum(last[inner - 1], last[inner]), before[inner - 1])
        current[inner] = cost[inner, diagonal - inner] + best
        before, last = last, current
    return float(last[n] / max(n, m))
