"""Spectral clustering of segments: seeded, with a kernel width taken from the data, whatever the data look like."""

import logging

import numpy as np
from scipy.sparse.linalg import ArpackError
from sklearn.cluster import spectral_clustering
from sklearn.metrics.pairwise import rbf_kernel
from sklearn.neighbors import NearestNeighbors

from lerobot_buds.core import FloatArray, IntArray, SegmentationError

logger = logging.getLogger(__name__)

MAX_CLUSTERED = 2500
"""Of more segments than these, so many stand for all: the kernel matrix of N takes about 4 * 8 * N**2 bytes, 0.2 GB."""

COMMON_SIMILARITY = 1e-6
"""Share of the mean similarity that any two segments have in common. Without it, segments far from all others leave
the leading eigenvalue so degenerate that 1,000 of them took a minute."""

SCALE_NEIGHBOR = 10
"""The kernel's width comes from the distance to this neighbour."""


def auto_gamma(features: FloatArray) -> float:
    """Chooses the width of the kernel ``exp(-gamma ||x - y||^2)`` from the data (ours; the release has it by hand).

    Args:
        features: ``(N, F)`` features, not all equal.

    Returns:
        2 / (median squared distance to the 10th neighbour), in which segments without a distance are left out.
    """
    neighbors = min(SCALE_NEIGHBOR, len(features) - 1)
    distances, _ = NearestNeighbors(n_neighbors=neighbors).fit(features).kneighbors()
    squared = distances[:, -1] ** 2
    if not squared.any():  # every segment has that many exact copies
        squared = np.square(features - features.mean(axis=0)).sum(axis=1)
    return 2.0 / float(np.median(squared[squared > 0]))


def cluster(features: FloatArray, n_clusters: int, random_state: int, gamma: float | None = None) -> IntArray:
    """Clusters segments by spectral clustering with a normalised cut, seeded.

    Args:
        features: ``(N, F)`` keyframe features, N at least 1.
        n_clusters: Clusters asked for, at least 1.
        random_state: Seed.
        gamma: Width of the kernel ``exp(-gamma ||x - y||^2)``; None for `auto_gamma`.

    Returns:
        ``(N,)`` int64 labels ``0 .. k-1``, all present. k is `n_clusters` unless there are fewer distinct segments or
        every way of assigning labels left a cluster empty.

    Raises:
        SegmentationError: The eigenvectors of the affinity could not be computed.
    """
    n_clusters = min(n_clusters, len(np.unique(features, axis=0)))
    if n_clusters == 1:
        return np.zeros(len(features), dtype=np.int64)
    if n_clusters == len(features):
        return np.arange(n_clusters, dtype=np.int64)
    # The seeded solver sees the segments in an order that neither the order of the demonstrations nor a rotation of
    # the latents changes, so neither changes the clusters.
    order = canonical_order(features)
    labels = np.empty(len(features), dtype=np.int64)
    if len(features) <= MAX_CLUSTERED:
        labels[order] = _spectral(features[order], n_clusters, random_state, gamma)
        return labels
    some = spread(features, MAX_CLUSTERED)
    labels[some] = _spectral(features[some], n_clusters, random_state, gamma)
    others = np.setdiff1d(order, some)
    nearest = NearestNeighbors(n_neighbors=1).fit(features[some]).kneighbors(features[others])[1][:, 0]
    labels[others] = labels[some[nearest]]
    return labels


def canonical_order(features: FloatArray) -> IntArray:
    """Orders segments by their distance from the mean, which no order of demonstrations and no rotation changes.

    Args:
        features: ``(N, F)`` features.
    """
    order: IntArray = np.argsort(np.square(features - features.mean(axis=0)).sum(axis=1), kind="stable")
    return order


def spread(features: FloatArray, most: int) -> IntArray:
    """Picks up to so many segments, evenly spread over the `canonical_order`, in that order."""
    order = canonical_order(features)
    return order[np.linspace(0, len(order) - 1, min(most, len(order))).astype(np.int64)]


def _spectral(features: FloatArray, n_clusters: int, random_state: int, gamma: float | None) -> IntArray:
    affinity = rbf_kernel(features, gamma=gamma or auto_gamma(features))
    affinity += COMMON_SIMILARITY * affinity.mean()
    best: IntArray | None = None
    # "discretize" is the released choice; it may leave a cluster empty or fail on a nearly diagonal affinity.
    for assignment in ("discretize", "cluster_qr", "kmeans"):
        try:
            found = spectral_clustering(
                affinity,
                n_clusters=n_clusters,
                eigen_solver="arpack",
                assign_labels=assignment,
                random_state=random_state,
            )
        except (np.linalg.LinAlgError, ArpackError) as error:
            logger.info("Spectral clustering with %s assignment failed: %s", assignment, error)
            continue
        labels = np.unique(found, return_inverse=True)[1].astype(np.int64)
        if best is None or labels.max() > best.max():
            best = labels
        if best.max() + 1 == n_clusters:
            return best
    if best is None:
        raise SegmentationError(
            f"Spectral clustering of {len(features)} segments into {n_clusters} skills failed: no eigenvectors were "
            "found. The latents of most segments are probably equal; check the representation, or lower the number "
            "of skills."
        )
    return best
