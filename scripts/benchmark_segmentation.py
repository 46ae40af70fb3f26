"""Times skill discovery: the tree against the published loop, latents to labels, many segments, and encoding.

All in one run; quote the ratios. Latents are synthetic: random walks around stages.

    python scripts/benchmark_segmentation.py
"""

import resource
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from lerobot.datasets import LeRobotDataset

from lerobot_buds.representation import Modalities, Representation, RepresentationConfig, encode_dataset
from lerobot_buds.segmentation import SkillDiscovery, build_tree
from lerobot_buds.segmentation.clustering import cluster
from lerobot_buds.segmentation.tree import window_bounds

WINDOW, DIMS, PENALTY = 10, 32, 0.2
NAIVE_LENGTHS, LENGTHS = (1000, 4000), (1000, 4000, 32_000)
DEMONSTRATIONS, FRAMES, SEGMENTS, SKILLS = 100, 430, 20_000, 8
IMAGES, BATCHES, VIDEO_FRAMES = 256, (8, 32, 256), 400
CAMERAS = {"observation.images.agentview": (128, 128), "observation.images.eye_in_hand": (128, 128)}


def latents(frames: int, seed: int) -> np.ndarray:
    """Makes latents that stay near one place for a hundred frames at a time."""
    rng = np.random.default_rng(seed)
    places = 3 * rng.normal(size=(frames // 100 + 1, DIMS))
    return places[np.arange(frames) // 100] + rng.normal(size=(frames, DIMS))


def timed[T](work: Callable[[], T], repeats: int = 1) -> tuple[T, float]:
    """Runs some work; returns its result and the shortest time that it took (s)."""
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        result = work()
        seconds.append(time.perf_counter() - began)
    return result, min(seconds)


def naive_merges(episode: np.ndarray) -> list[tuple[int, int]]:
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


def trees() -> None:
    """Times the tree of one demonstration, where bearable against the published loop with the same merges."""
    for length in LENGTHS:
        episode = latents(length, seed=length)
        tree, seconds = timed(lambda episode=episode: build_tree(episode, WINDOW, PENALTY), repeats=3)
        line = f"tree of {length:6} frames: {seconds:8.4f} s"
        if length in NAIVE_LENGTHS:
            merges, slow = timed(lambda episode=episode: naive_merges(episode))
            same = [tuple(b) for b in tree.bounds[len(window_bounds(length, WINDOW)) :].tolist()] == merges
            line += f"; the published loop {slow:8.3f} s, {slow / seconds:5.0f} times, same merges: {same}"
        print(line, flush=True)


def discovery() -> None:
    """Times everything between latents and labels for a set of demonstrations of a usual size."""
    episodes = [latents(FRAMES, seed) for seed in range(DEMONSTRATIONS)]
    found, seconds = timed(lambda: SkillDiscovery(max_skills=SKILLS).fit(episodes))
    print(f"{DEMONSTRATIONS} demonstrations of {FRAMES} frames to labels: {seconds:.2f} s ({found.n_skills_} skills)")


def many_segments() -> tuple[float, float]:
    """Clusters many segments; returns the time (s) and by how much the process grew (GiB)."""
    rng = np.random.default_rng(0)
    features = 3 * rng.normal(size=(SKILLS, 3 * DIMS))[rng.integers(SKILLS, size=SEGMENTS)]
    features += rng.normal(size=features.shape)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    _, seconds = timed(lambda: cluster(features, SKILLS, 0))
    return seconds, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 2**20


def encoder() -> None:
    """Times the encoder at the published size, on decoded images: batches of several sizes, and one at a time."""
    network = untrained().network
    frames = {name: torch.rand(IMAGES, 3, 128, 128) for name in CAMERAS}

    @torch.inference_mode()
    def encode(batch: int) -> torch.Tensor:
        parts = [{n: x[i : i + batch] for n, x in frames.items()} for i in range(0, IMAGES, batch)]
        return torch.cat([network.latents(part) for part in parts])

    single, slow = timed(lambda: encode(1), repeats=3)
    for batch in BATCHES:
        latents, seconds = timed(lambda batch=batch: encode(batch), repeats=3)
        print(
            f"encoder in batches of {batch:3}: {IMAGES / seconds:.0f} frames/s, one by one {IMAGES / slow:.0f}, "
            f"{slow / seconds:.1f} times (largest difference {float((latents - single).abs().max()):.1e})",
            flush=True,
        )


def dataset() -> None:
    """Times the way from a dataset's videos to latents: ours, and frame by frame through LeRobotDataset."""
    representation = untrained()
    with TemporaryDirectory() as place:
        folder = Path(place)
        frames = write_videos(folder / "videos")
        ours, seconds = timed(lambda: encode_dataset(folder / "videos", representation, cache_dir=folder / "cache"))
        _, again = timed(lambda: encode_dataset(folder / "videos", representation, cache_dir=folder / "cache"))
        stored = LeRobotDataset("benchmark/videos", root=folder / "videos")

        @torch.no_grad()
        def frame_by_frame() -> torch.Tensor:
            items = (stored[i] for i in range(len(stored)))
            return torch.cat([representation.network.latents({n: item[n][None] for n in CAMERAS}) for item in items])

        theirs, slow = timed(frame_by_frame)
        error = np.abs(np.concatenate(ours) - theirs.numpy()).max()
    print(
        f"videos to latents, {frames} frames of two cameras: {frames / seconds:.0f} frames/s, "
        f"frame by frame {frames / slow:.0f}, {slow / seconds:.1f} times (largest difference {error:.1e}); "
        f"from the cache {again:.2f} s"
    )


def untrained() -> Representation:
    """Makes the two-camera representation of the published size; its speed does not depend on training."""
    return Representation.untrained(Modalities(CAMERAS, (), ()), RepresentationConfig(device="cpu"))


def write_videos(root: Path) -> int:
    """Records two episodes of a bright bar that wanders over a gradient; returns the number of frames."""
    images = {
        name: {"dtype": "video", "shape": (128, 128, 3), "names": ["height", "width", "channels"]} for name in CAMERAS
    }
    state = {"dtype": "float32", "shape": (1,), "names": ["x"]}
    features = {**images, "observation.state": state, "action": state}
    videos = LeRobotDataset.create("benchmark/videos", 20, features, root=root)
    gradient = np.linspace(0, 120, 128, dtype=np.uint8)[:, None, None] * np.ones((1, 128, 3), dtype=np.uint8)
    for _ in range(2):
        for t in range(VIDEO_FRAMES // 2):
            image = gradient.copy()
            image[:, t % 112 : t % 112 + 16] += 100
            zero = np.zeros(1, dtype=np.float32)
            frame = {**dict.fromkeys(CAMERAS, image), "observation.state": zero, "action": zero, "task": "wander"}
            videos.add_frame(frame)
        videos.save_episode()
    videos.finalize()
    return VIDEO_FRAMES


def main() -> None:
    """Runs all of it; the clustering in a process of its own, whose memory is counted."""
    trees()
    discovery()
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        seconds, memory = pool.submit(many_segments).result()
    print(f"partition of {SEGMENTS} segments into {SKILLS}: {seconds:.1f} s, {memory:.2f} GiB")
    encoder()
    dataset()


if __name__ == "__main__":
    main()
