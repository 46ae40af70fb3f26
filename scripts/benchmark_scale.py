"""Measures time, memory and disk of a segmentation for growing numbers of episodes, stage by stage.

    python scripts/benchmark_scale.py --episodes 50 500 5000 --seconds 8 --json=scale.json

The datasets have a state and an action of six joints and no cameras, so that 5,000 episodes can be made here: frames
are decoded one after the other, into a store of known size, and add time and disk in proportion (docs/datasets.md).
Every number of episodes runs in a process of its own, whose largest memory is read at its end.
"""

import argparse
import json
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

FPS = 30
_PARTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
JOINTS = [f"{name}.pos" for name in _PARTS]
STAGES = 4
STEPS = 200


def make_dataset(root: Path, episodes: int, frames: int) -> None:
    """Writes one episode through LeRobot, whose writer is slow, and then as many as asked in the same form."""
    from lerobot_buds.data.writing import create_dataset, vector_feature, write_episode

    features = {name: vector_feature(JOINTS) for name in ("observation.state", "action")}
    dataset = create_dataset("local/scale", root, FPS, features)
    rng = np.random.default_rng(0)
    waypoints = rng.normal(0, 40, (STAGES + 1, len(JOINTS)))
    motion = trajectory(rng, waypoints, frames)
    write_episode(dataset, {"observation.state": motion, "action": motion}, "carry it")
    dataset.finalize()
    multiply(root, rng, waypoints, episodes, frames)


def trajectory(rng: np.random.Generator, waypoints: NDArray[Any], frames: int) -> NDArray[np.float32]:
    """Minimum-jerk motions between waypoints, of jittered lengths, ``(T, 6)`` degrees."""
    cuts = (np.arange(1, STAGES) * frames / STAGES + rng.uniform(-0.1, 0.1, STAGES - 1) * frames / STAGES).astype(int)
    edges = [0, *cuts.tolist(), frames]
    parts = []
    for k in range(STAGES):
        s = np.linspace(0, 1, edges[k + 1] - edges[k])[:, None]
        parts.append(waypoints[k] + (10 * s**3 - 15 * s**4 + 6 * s**5) * (waypoints[k + 1] - waypoints[k]))
    return (np.concatenate(parts) + rng.normal(0, 0.5, (frames, len(JOINTS)))).astype(np.float32)


def multiply(root: Path, rng: np.random.Generator, waypoints: NDArray[Any], episodes: int, frames: int) -> None:
    """Replaces the rows and the episode records of a dataset of one episode by those of many."""
    shard, records = next((root / "data").rglob("*.parquet")), next((root / "meta/episodes").rglob("*.parquet"))
    schema, record = pq.read_schema(shard), pq.read_table(records).to_pylist()[0]
    with pq.ParquetWriter(shard, schema) as writer:
        for number in range(episodes):
            motion = pa.FixedSizeListArray.from_arrays(trajectory(rng, waypoints, frames).reshape(-1), len(JOINTS))
            columns = {
                "observation.state": motion,
                "action": motion,
                "timestamp": np.arange(frames, dtype=np.float32) / FPS,
                "frame_index": np.arange(frames),
                "episode_index": np.full(frames, number),
                "index": number * frames + np.arange(frames),
                "task_index": np.zeros(frames, np.int64),
            }
            arrays = [pa.array(columns[name]).cast(schema.field(name).type) for name in schema.names]
            writer.write_table(pa.table(arrays, schema=schema))
    rows = [
        {**record, "episode_index": n, "dataset_from_index": n * frames, "dataset_to_index": (n + 1) * frames}
        for n in range(episodes)
    ]
    pq.write_table(pa.Table.from_pylist(rows, pq.read_schema(records)), records)
    info = json.loads((root / "meta/info.json").read_text())
    info |= {"total_episodes": episodes, "total_frames": episodes * frames, "splits": {"train": f"0:{episodes}"}}
    (root / "meta/info.json").write_text(json.dumps(info))


def measure(episodes: int, seconds: float) -> dict[str, Any]:
    """Runs all stages on one dataset, in this process; seconds of each, and the largest memory so far (MiB)."""
    from lerobot_buds.core import frames_of_seconds
    from lerobot_buds.data import check_demonstrations
    from lerobot_buds.representation import RepresentationConfig, encode_dataset, train_representation
    from lerobot_buds.segmentation import DiscoveryConfig, SegmentationRecord, write_segmented_dataset

    frames = round(seconds * FPS)
    found: dict[str, Any] = {"episodes": episodes, "frames": episodes * frames, "stages": {}}
    with TemporaryDirectory(dir=".") as place:
        folder, began = Path(place), time.monotonic()

        def done(stage: str) -> None:
            nonlocal began
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            found["stages"][stage] = {"seconds": round(time.monotonic() - began, 2), "peak_mib": round(peak)}
            began = time.monotonic()

        root, cache = folder / "data", folder / "cache"
        make_dataset(root, episodes, frames)
        done("(made)")
        check_demonstrations(root, [], cache_dir=cache)
        done("checks")
        settings = RepresentationConfig(cameras=[], steps=STEPS, checkpoint_interval=STEPS, device="cpu")
        representation = train_representation(root, settings, folder / "representation", cache)
        done(f"training, {STEPS} steps")
        latents = encode_dataset(root, representation, cache_dir=cache)
        done("encoding")
        discovery = DiscoveryConfig().build(FPS).fit(latents)
        done("discovery")
        horizon = frames_of_seconds(1.5, FPS)
        record = SegmentationRecord.of_labels(discovery.labels_, repo_id="local/scale", fps=FPS, horizon=horizon)
        write_segmented_dataset(root, folder / "skills", "local/scale_skills", record)
        done("writing the copy")
        found |= {"skills": discovery.n_skills_, "segments": sum(map(len, discovery.temporal_segments_))}
        found["disk_mib"] = {
            name: round(sum(p.stat().st_size for p in (folder / name).rglob("*") if p.is_file()) / 2**20, 1)
            for name in ("data", "skills", "cache")
        }
        shutil.rmtree(folder / "skills")
    return found


def main() -> None:
    """Runs every number of episodes in a process of its own and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, nargs="+", default=[50, 500, 5000])
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--alone", action="store_true", help="measure in this process (used by the script itself)")
    options = parser.parse_args()
    if options.alone:
        print(json.dumps(measure(options.episodes[0], options.seconds)))
        return
    results = []
    for episodes in options.episodes:
        command = [sys.executable, __file__, "--alone", f"--episodes={episodes}", f"--seconds={options.seconds}"]
        result = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])
        results.append(result)
        if options.json:
            options.json.write_text(json.dumps(results, indent=2) + "\n")
        stages = ", ".join(f"{n} {s['seconds']} s" for n, s in result["stages"].items())
        peak = max(stage["peak_mib"] for stage in result["stages"].values())
        print(f"{episodes} episodes, {result['frames']} frames, {result['segments']} segments: {stages}; {peak} MiB")


if __name__ == "__main__":
    main()
