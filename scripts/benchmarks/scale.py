"""How time and memory of a segmentation grow with its demonstrations, stage by stage.

The datasets have a state and an action of six joints and no cameras, so that 5,000 demonstrations can be made here:
frames are decoded one after the other, into a store of known size, and add time and disk in proportion
(docs/datasets.md). Every number of demonstrations runs in a process of its own, whose largest memory is read.
"""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_buds.core import frames_of_seconds
from lerobot_buds.data import check_demonstrations
from lerobot_buds.data.writing import create_dataset, vector_feature, write_episode
from lerobot_buds.representation import RepresentationConfig, encode_dataset, train_representation
from lerobot_buds.segmentation import DiscoveryConfig, SegmentationRecord, write_segmented_dataset

from .figures import Figure, Setting, alone, largest_memory

FPS, SECONDS, STAGES, STEPS = 30, 8, 4, 200
_PARTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
JOINTS = [f"{name}.pos" for name in _PARTS]


def measure(setting: Setting) -> Iterator[Figure]:
    """Segments more and more demonstrations of 8 s."""
    for count in setting.size.demonstrations:
        yield from alone(_segmented, setting.place / f"episodes_{count}", count)


def _segmented(folder: Path, episodes: int) -> list[Figure]:
    """Runs all stages on one dataset."""
    figures: list[Figure] = []
    root, cache, began = folder / "data", folder / "cache", time.monotonic()

    def done(stage: str) -> None:
        nonlocal began
        figures.append(Figure(stage, time.monotonic() - began, "s", at=episodes))
        began = time.monotonic()

    make_dataset(root, episodes, SECONDS * FPS)
    began = time.monotonic()
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
    figures.append(Figure("largest memory", largest_memory(), "GiB", at=episodes))
    return figures


def make_dataset(root: Path, episodes: int, frames: int) -> None:
    """Writes one episode through LeRobot, whose writer is slow, and then as many as asked in the same form."""
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
