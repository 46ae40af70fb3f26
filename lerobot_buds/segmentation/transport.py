"""Optimal transport between frames and prototypes of actions, in the manner of ASOT (Xu & Gould, CVPR 2024).

Written from the paper's idea, for latents that are there: no features are learned. Each frame of a demonstration gives
its mass to prototypes that it is near to and that its neighbours in time give theirs to; how much a prototype takes is
free, at a price, since no demonstration does everything equally long.
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import softmax
from sklearn.cluster import KMeans
from sklearn.metrics.pairwise import euclidean_distances

from lerobot_buds.core import FloatArray, IntArray, segments_of

from .baselines import tile

_FITTED = 20_000
"""Most frames, spread over all demonstrations, that prototypes are fitted to."""

_ITERATIONS, _CONVERGED, _TINY = 200, 1e-4, 1e-30


def prototypes_of(latents: Sequence[FloatArray], count: int, random_state: int = 0) -> FloatArray:
    """Finds prototypes of actions, ``(K, D)``, among the frames of all demonstrations by k-means, seeded.

    Args:
        latents: ``(T, D)`` latents of every demonstration.
        count: Number of prototypes; fewer where there are fewer distinct frames.
        random_state: Seed.
    """
    frames = np.concatenate(latents)
    frames = frames[np.linspace(0, len(frames) - 1, min(_FITTED, len(frames))).astype(np.int64)]
    count = min(count, len(np.unique(frames, axis=0)))
    centers: FloatArray = KMeans(count, n_init=3, random_state=random_state).fit(frames).cluster_centers_
    return centers


def transport_plan(
    cost: FloatArray, radius: int, structure: float = 0.4, balance: float = 0.05, entropy: float = 0.07
) -> FloatArray:
    """Solves fused, unbalanced Gromov-Wasserstein transport by mirror descent, projected onto the frames' marginal.

    Minimised over plans P whose rows sum to 1 is ``(1 - structure) <cost, P>``, plus `structure` times the mass that
    frames within the radius give to different prototypes, plus `balance` times the divergence of the prototypes' shares
    from equal ones, less `entropy` times the entropy of P. A step multiplies P by the exponential of the negative
    gradient, and rows are normalised again.

    Args:
        cost: ``(T, K)`` cost of giving a frame to a prototype, about 1 in the mean.
        radius: Frames on either side in which one prototype is preferred.
        structure: Weight of temporal consistency (alpha; 0.4: the release's for Breakfast).
        balance: Price of unequal shares (lambda; 0.05: likewise); 0 lets a prototype go unused at no price.
        entropy: Weight of the entropy (epsilon; ours).

    Returns:
        ``(T, K)`` plan.
    """
    near, window = (1 - structure) * cost, 2 * radius + 1
    rate = 1 / (2 + balance / entropy)  # shorter where shares cost more: they all move at once
    plan: FloatArray = softmax(-near / entropy, axis=1)
    for _ in range(_ITERATIONS):
        # What neighbours give to others is all they have, which is the same for each, less what this one gets.
        kept = (window * uniform_filter1d(plan, window, axis=0, mode="constant") - plan) / max(1, radius)
        share = np.log(cost.shape[1] * plan.mean(axis=0) + _TINY)
        gradient = near - structure * kept + balance * share
        # Part of the way, in logarithms, to the plan that is best for this gradient.
        before, plan = plan, softmax((1 - rate) * np.log(plan + _TINY) - rate * gradient / entropy, axis=1)
        if np.abs(plan - before).max() < _CONVERGED:
            break
    return plan


def transport_segments(latents: FloatArray, prototypes: FloatArray, radius: int, min_length: int) -> IntArray:
    """Cuts a demonstration where the prototype that takes most of a frame changes.

    Args:
        latents: ``(T, D)`` latents.
        prototypes: ``(K, D)`` prototypes, see `prototypes_of`.
        radius: Frames on either side in which one prototype is preferred.
        min_length: Shortest segment (frames).

    Returns:
        ``(S, 2)`` half-open spans; what is too short is given to the better of its neighbours.
    """
    if len(latents) < 2 * min_length:
        return tile([], len(latents))
    cost = euclidean_distances(latents, prototypes, squared=True)
    plan = transport_plan(cost / max(float(cost.mean()), 1e-12), radius)
    labels = plan.argmax(axis=1).astype(np.int64)
    while len(runs := segments_of(labels)) > 1:
        short = min(runs, key=lambda run: run.length)
        if short.length >= min_length:
            break
        mass = plan[short.start : short.end].sum(axis=0)
        beside = [run.label for run in runs if run.end == short.start or run.start == short.end]
        labels[short.start : short.end] = max(beside, key=lambda label: mass[label])
    return tile([run.start for run in runs[1:]], len(latents), min_length)
