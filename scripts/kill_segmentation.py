"""Kills ``lerobot-buds-segment`` at random moments and checks that nothing is lost and that a rerun ends the same.

Records a small dataset of random walks, segments it once without a kill, then again and again in a fresh folder: each
time the process group gets SIGKILL at a random moment, the source and an earlier output must be whole and the target
absent or whole, and a rerun must end with the bytes of the unbroken run: dataset, pictures and representation.

    python scripts/kill_segmentation.py --kills=50

All runs are forks of one process that has imported everything, so that the moments fall into the work.
"""

import os
import random
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from tempfile import TemporaryDirectory

import draccus

STAGES = ("checks", "decoding", "training", "picture", "encoding", "discovery", "writing", "finished")
CAMERAS = ("observation.images.front", "observation.images.wrist")
FPS = 20
# What a pass imports on the way, beside its command: seconds in which a kill would hit no work.
PRELOADED = ["__main__", "lerobot_buds.cli.segmentation_pass", "lerobot.datasets", "torch._dynamo", "scipy.io"]
LONGEST_S = 600.0


@dataclass
class KillConfig:
    """Settings of the experiment."""

    kills: int = 50
    """Number of runs that are killed."""

    seed: int = 0
    """Seeds the moments of the kills, uniform over the time of the unbroken run."""

    episodes: int = 6
    """Demonstrations of the dataset."""

    frames: int = 80
    """Frames of each."""

    image_size: int = 64
    """Side of its two cameras (pixels)."""

    steps: int = 20
    """Training steps of the representation."""

    checkpoint_interval: int = 4
    """Steps between checkpoints."""


def record(config: KillConfig, root: Path) -> None:
    """Records demonstrations of two stages: a square on noise wanders, its colour is that of the stage."""
    import numpy as np

    from lerobot_buds.core import ACTION, STATE
    from lerobot_buds.data.writing import camera_feature, create_dataset, vector_feature, write_episode

    size, rng = config.image_size, np.random.default_rng(0)
    features = {camera: camera_feature((size, size, 3), video=True) for camera in CAMERAS}
    features |= {STATE: vector_feature(["eef_x.pos", "eef_y.pos"]), ACTION: vector_feature(["x", "y"])}
    dataset = create_dataset("local/walks", root, FPS, features)
    for _ in range(config.episodes):
        actions = rng.normal(size=(config.frames, 2)).astype(np.float32)
        places = np.abs(actions.cumsum(axis=0) + size / 2) % (size - 8)
        images = rng.integers(0, 60, (config.frames, size, size, 3), dtype=np.uint8)
        for t, (x, y) in enumerate(places.astype(int)):
            images[t, y : y + 8, x : x + 8, 2 * t // config.frames] = 255
        columns = {STATE: places, ACTION: actions, **dict.fromkeys(CAMERAS, images)}
        write_episode(dataset, columns, "wander")
    dataset.finalize()


def segment_in_group(config: KillConfig, source: Path, folder: Path, log: Path) -> None:
    """Runs the segmentation pass in a process group of its own; what it says goes into a file."""
    os.setpgid(0, 0)
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, sys.stdout.fileno())
    os.dup2(output, sys.stderr.fileno())
    from lerobot_buds.cli.segment import SegmentConfig, segment
    from lerobot_buds.representation import RepresentationConfig
    from lerobot_buds.segmentation import DiscoveryConfig

    representation = RepresentationConfig(
        image_size=config.image_size // 2,
        latent_dim=8,
        steps=config.steps,
        batch_size=32,
        checkpoint_interval=config.checkpoint_interval,
        device="cpu",
    )
    discovery = DiscoveryConfig(max_skills=4, min_skill_s=0.5)
    segment(
        SegmentConfig(
            "local/walks",
            str(source),
            output_root=str(folder / "skills"),
            work_dir=str(folder / "work"),
            representation=representation,
            discovery=discovery,
        )
    )


class Experiment:
    """The folders of the experiment and the runs in them."""

    def __init__(self, config: KillConfig, folder: Path) -> None:
        self.config, self.folder = config, folder
        self.source, self.reference, self.run = folder / "source", folder / "reference", folder / "run"
        self.cache = Path(os.environ["HF_LEROBOT_HOME"]) / "buds_cache"
        self.context = get_context("forkserver")
        self.context.set_forkserver_preload(PRELOADED)

    def start(self, target: Callable[..., None], *arguments: Path) -> BaseProcess:
        """Starts a function in a fork."""
        process = self.context.Process(target=target, args=(self.config, *arguments))
        process.start()
        return process

    def finish(self, target: Callable[..., None], *arguments: Path) -> float:
        """Runs a function in a fork to its end; returns how long it took (s)."""
        began = time.monotonic()
        process = self.start(target, *arguments)
        process.join(LONGEST_S)
        if process.exitcode != 0:
            raise SystemExit(f"a run ended with {process.exitcode}; see {self.folder / 'log'}")
        return time.monotonic() - began

    def segment_to(self, folder: Path) -> float:
        """Segments without a kill; returns how long it took (s)."""
        return self.finish(segment_in_group, self.source, folder, self.folder / "log")

    def kill_after(self, seconds: float) -> bool:
        """Starts the segmentation in the fresh folder and kills its process group, unless it ended sooner."""
        process = self.start(segment_in_group, self.source, self.run, self.folder / "log")
        process.join(seconds)
        if process.is_alive():
            try:
                os.killpg(process.pid, signal.SIGKILL)
            except ProcessLookupError:  # it has no group of its own yet
                process.kill()
        process.join()
        return process.exitcode == -signal.SIGKILL

    def clear(self) -> None:
        """Makes the next run start from nothing."""
        shutil.rmtree(self.run, ignore_errors=True)
        shutil.rmtree(self.cache, ignore_errors=True)

    def stage(self) -> str:
        """Tells from the files how far a killed run came."""
        frames = [path for path in self.cache.glob("*.npy") if not path.name.startswith("latents")]
        if (self.run / "skills").exists():
            return "finished"
        if (self.run / "work/timeline.png").exists():
            return "writing"
        if any(self.cache.glob("latents-*.npy")):
            return "discovery"
        if (self.run / "work/reconstructions.png").exists():
            return "encoding"
        if (self.run / "work/representation/representation.json").exists():
            return "picture"
        if len(frames) == len(CAMERAS):
            return "training"
        return "decoding" if frames or any(self.cache.glob(".*.part")) else "checks"


def contents(root: Path) -> dict[str, str]:
    """Hashes every file below a folder but the empty ones that lock it."""
    from lerobot_buds.core import sha256_of_file

    files = [path for path in sorted(root.rglob("*")) if path.is_file() and path.suffix != ".lock"]
    return {str(path.relative_to(root)): sha256_of_file(path) for path in files}


def faults_of(experiment: Experiment, before: dict[str, dict[str, str]]) -> list[str]:
    """Lists what a kill broke, then segments again to the end and lists what differs from the unbroken run."""
    faults = [f"{name} changed" for name in before if contents(experiment.folder / name) != before[name]]
    skills = experiment.run / "skills"
    if not skills.exists():
        experiment.segment_to(experiment.run)
    elif contents(skills) != contents(experiment.reference / "skills"):
        faults.append("half a target")
    ours, theirs = contents(experiment.run), before["reference"]
    faults += [f"{name} differs" for name in sorted(ours.keys() | theirs) if ours.get(name) != theirs.get(name)]
    faults += [f"{path.name} left in the cache" for path in experiment.cache.glob(".*.part")]
    faults += [f"{name} changed by the rerun" for name in before if contents(experiment.folder / name) != before[name]]
    return faults


def kill_often(config: KillConfig, folder: Path) -> Counter[tuple[str, str]]:
    """Runs the experiment; returns how often a kill in which stage had which outcome."""
    experiment = Experiment(config, folder)
    experiment.finish(record, experiment.source)
    seconds = experiment.segment_to(experiment.run)
    experiment.clear()
    seconds = min(seconds, experiment.segment_to(experiment.reference))
    experiment.clear()
    before = {name: contents(folder / name) for name in ("source", "reference")}
    print(f"unbroken run: {seconds:.2f} s, {len(before['reference'])} files", flush=True)
    moments, counts = random.Random(config.seed), Counter()
    while counts.total() < config.kills:
        moment = moments.uniform(0, seconds)
        if experiment.kill_after(moment):
            number, stage, faults = counts.total(), experiment.stage(), faults_of(experiment, before)
            counts[stage, "broken" if faults else "whole"] += 1
            print(f"kill {number} after {moment:.2f} s, {stage}: {', '.join(faults) or 'whole'}", flush=True)
        experiment.clear()
    return counts


def main() -> None:
    """Prints a table of stages and outcomes; ends with 1 if a kill broke anything."""
    config = draccus.parse(KillConfig)
    with TemporaryDirectory() as folder:
        # Read by LeRobot and by `datasets` when they are imported, which the forks' parent has yet to do.
        os.environ |= {"HF_LEROBOT_HOME": f"{folder}/home", "HF_HOME": f"{folder}/home", "HF_HUB_OFFLINE": "1"}
        counts = kill_often(config, Path(folder))
    print(f"{'killed while':12} {'whole':>6} {'broken':>6}")
    for stage in STAGES:
        print(f"{stage:12} {counts[stage, 'whole']:6} {counts[stage, 'broken']:6}")
    print(f"{'all':12} {sum(n for (_, o), n in counts.items() if o == 'whole'):6} of {config.kills} whole")
    sys.exit(int(any(outcome == "broken" for _, outcome in counts)))


if __name__ == "__main__":
    main()
