"""How fast latents become labels: the tree of one demonstration, many demonstrations, many segments."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from lerobot_buds.segmentation import SkillDiscovery, build_tree
from lerobot_buds.segmentation.clustering import cluster
from lerobot_buds.segmentation.tree import window_bounds

from .figures import Figure, Setting, alone, largest_memory, median_seconds, once

WINDOW, DIMS, PENALTY, SKILLS = 10, 32, 0.2, 8
LONGEST_FOR_THE_LOOP = 1_000
DEMONSTRATIONS, FRAMES = 100, 430


def measure(setting: Setting) -> Iterator[Figure]:
    """Takes random walks around stages."""
    length = min(LONGEST_FOR_THE_LOOP, setting.size.latents)
    loop = f"published loop, {length} frames"
    yield Figure(loop, once(partial(published_merges, latents(length, seed=0))), "s")
    for frames in (length, setting.size.latents):
        tree = partial(build_tree, latents(frames, seed=0), WINDOW, PENALTY)
        against = loop if frames == length else ""
        yield Figure(f"tree of {frames} frames", median_seconds(tree, setting.size.repeats), "s", against)
    count = DEMONSTRATIONS if setting.size.repeats > 1 else 4
    episodes = [latents(FRAMES, seed) for seed in range(count)]
    found = once(lambda: SkillDiscovery(max_skills=SKILLS).fit(episodes))
    yield Figure(f"{count} demonstrations of {FRAMES} frames to labels", found, "s")
    seconds, memory = alone(partition, setting.size.segments)
    yield Figure(f"{setting.size.segments} segments partitioned", seconds, "s")
    yield Figure("memory of that", memory, "GiB")


def latents(frames: int, seed: int) -> np.ndarray:
    """Makes latents that stay near one place for a hundred frames at a time."""
    rng = np.random.default_rng(seed)
    places = 3 * rng.normal(size=(frames // 100 + 1, DIMS))
    return places[np.arange(frames) // 100] + rng.normal(size=(frames, DIMS))


def published_merges(episode: np.ndarray) -> list[tuple[int, int]]:
    """Merges as the published loop does: every mean and every distance anew before every merge."""
    parts = [tuple(bounds) for bounds in window_bounds(len(episode), WINDOW).tolist()]
    merges = []
    while len(parts) > 1:
        means = [episode[start:end].mean(axis=0) for start, end in parts]
        costs = [
            np.linalg.norm(means[i] - means[i + 1]) + PENALTY * (parts[i + 1][1] - parts[i][0]) / len(parts)
            for i in range(len(parts) - 1)
        ]
        i = int(np.argmin(costs))
        parts[i : i + 2] = [(parts[i][0], parts[i + 1][1])]
        merges.append(parts[i])
    return merges


def partition(segments: int) -> tuple[float, float]:
    """Clusters many segments; returns the time (s) and by how much the process grew (GiB)."""
    rng = np.random.default_rng(0)
    features = 3 * rng.normal(size=(SKILLS, 3 * DIMS))[rng.integers(SKILLS, size=segments)]
    features += rng.normal(size=features.shape)
    before = largest_memory()
    seconds = once(lambda: cluster(features, SKILLS, 0))
    return seconds, largest_memory() - before
