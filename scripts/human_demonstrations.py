"""Finds skills in the human demonstrations that older robosuite wheels carry, and draws them, for docs/human.md.

Real teleoperation by people: a Panda at 20 Hz (robosuite 1.0.1), a Sawyer at some 100 Hz (0.3.0, taken at 20 Hz here).
The wheels are fetched by pip, their simulator states played back and drawn, and each task becomes a LeRobotDataset in
which skills are looked for. What is found is scored against the gripper's commands, which a person gave.
Everything is kept below the output folder; an interrupted run goes on with what is missing.

    python scripts/human_demonstrations.py
"""

import logging
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import draccus
import numpy as np
from human_pictures import Episode, draw_episode, draw_ribbons

from lerobot_buds.core import ACTION, IntArray, labels_of, read_json, segments_of, write_json
from lerobot_buds.data import read_table
from lerobot_buds.demos.hdf5 import Source, open_demonstrations
from lerobot_buds.demos.hdf5.robosuite import PlayedDemonstrations
from lerobot_buds.demos.importing import Import, import_demonstrations
from lerobot_buds.evaluation import agreement, label_distance
from lerobot_buds.representation import RepresentationConfig
from lerobot_buds.segmentation import DiscoveryConfig, discover_skills

FPS = 20
ASSETS = "robosuite/models/assets/"
FUMBLE_S = 0.5
"""A grip that a person corrects within this time (s) is no step of the task."""

BRIEF_S = 0.5
"""What a skill lasts at least (s) to be counted in a round: boundaries are scored no finer."""

NOTHING = "nothing"
LIFTED_M = 0.04
"""What the hand carries is at least this much higher than where it lay (m)."""

# Seconds of computing on two cores; a single episode or two leave none to hold out.
REPRESENTATION = RepresentationConfig(
    proprioception=["eef*", "*gripper*"],
    image_size=64,
    batch_size=32,
    learning_rate=2e-3,
    steps=800,
    checkpoint_interval=200,
    validation_fraction=0.0,
    patience=0,
)


@dataclass(frozen=True)
class Recording:
    """One file of one wheel.

    Attributes:
        version: The robosuite whose wheel it is in.
        folder: Where it lies below the wheel's demonstrations.
        task: What was done, in words.
        resample: Rows a second to take of states that are not equally far apart; None for all.
        profile: What is drawn; the Sawyer has no second set of meshes, and takes long to draw in full.
    """

    version: str
    folder: str
    task: str
    resample: float | None = None
    profile: str = "full"


RECORDINGS = {
    "panda_pick_place": Recording("1.0.1", "pick-place/panda", "put milk, bread, cereal and can into their bins"),
    "panda_nut_assembly": Recording("1.0.1", "nut-assembly/panda", "put both nuts onto their pegs"),
    "sawyer_pick_place": Recording(
        "0.3.0", "SawyerPickPlace", "put milk, bread, cereal and can into their bins", FPS, "fast"
    ),
    "sawyer_nut_assembly": Recording("0.3.0", "SawyerNutAssembly", "put both nuts onto their pegs", FPS, "fast"),
}

SETTINGS = {
    "default": DiscoveryConfig(),
    # Cut by means as in the paper, into as many segments as one episode of eight rounds may have, and told how many
    # skills the gripper knows: with an empty hand, and with a full one.
    "two": DiscoveryConfig(
        feature="mean", search="best_first", segments_per_episode=16, min_segment_s=1.0, consolidate=False, n_skills=2
    ),
}

SHOWN = {
    "panda_pick_place": "default",
    "panda_nut_assembly": "default",
    "sawyer_pick_place": "two",
    "sawyer_nut_assembly": "two",
}
"""Setting with which a task is drawn."""


@dataclass
class HumanConfig:
    """What to do."""

    output: Path = Path("outputs/human")
    """Where wheels, datasets, results and pictures are kept."""

    pictures: Path | None = None
    """Folder of the pictures; None for the output's."""

    seeds: int = 1
    """Number of seeds of the representation and of the clustering, from 0."""


def fetch(version: str, cache: Path) -> Path:
    """Fetches a wheel by pip, and unpacks its demonstrations and what draws their scenes; returns their folder."""
    folder = cache / version
    if not (folder / ASSETS).exists():
        cache.mkdir(parents=True, exist_ok=True)
        pip = [sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary=:all:", "--quiet"]
        subprocess.run([*pip, f"--dest={cache}", f"robosuite=={version}"], check=True)
        (wheel,) = cache.glob(f"robosuite-{version}-*.whl")
        part = cache / f".{version}.part"
        with zipfile.ZipFile(wheel) as archive:
            wanted = [n for n in archive.namelist() if n.startswith(ASSETS) and "bullet_data" not in n]
            archive.extractall(part, wanted)
        part.rename(folder)
    return folder / ASSETS


def source_of(recording: Recording, assets: Path) -> Source:
    """Makes the settings with which a recording is read."""
    return Source(
        path=assets / "demonstrations" / recording.folder / "demo.hdf5",
        resample=recording.resample,
        render_profile=recording.profile,
        assets=assets,
    )


def import_recording(name: str, assets: Path, root: Path) -> None:
    """Makes the dataset of a recording, unless it is there."""
    recording = RECORDINGS[name]
    if not root.exists():
        import_demonstrations(Import(source_of(recording, assets), f"human/{name}", root, recording.task))


def truths(name: str, assets: Path, root: Path) -> list[Episode]:
    """Reads what the person did in every episode: the gripper's commands, and how high things were lifted."""
    table = read_table(root, [ACTION])
    bounds = list(zip(table.starts.tolist(), table.ends.tolist(), strict=True))
    closed = [(table.columns[ACTION][start:end, -1] > open_command(name)).astype(np.int64) for start, end in bounds]
    with open_demonstrations(source_of(RECORDINGS[name], assets)) as demonstrations:
        assert isinstance(demonstrations, PlayedDemonstrations)
        things = [demonstrations.bodies(episode) for episode in demonstrations.lengths]
    heights = [{body: at[:, 2] - at[0, 2] for body, at in bodies.items()} for bodies in things]
    return [
        Episode(f"{name} {number}", root, start, end, without_fumbles(grip), height)
        for number, ((start, end), grip, height) in enumerate(zip(bounds, closed, heights, strict=True))
    ]


def open_command(name: str) -> float:
    """Tells the gripper's command above which it closes: -1 opens; 1 (Panda) or 0 (Sawyer) closes."""
    return 0.0 if name.startswith("panda") else -0.5


def without_fumbles(closed: IntArray) -> IntArray:
    """Leaves out openings and closings that were taken back within `FUMBLE_S`, the shortest first."""
    segments = segments_of(closed)
    while len(segments) > 1:
        shortest = min(range(len(segments)), key=lambda number: segments[number].length)
        if segments[shortest].length >= FUMBLE_S * FPS:
            break
        flipped = [s._replace(label=1 - s.label) if n == shortest else s for n, s in enumerate(segments)]
        segments = segments_of(labels_of(flipped))
    return labels_of(segments)


def rounds(episode: Episode) -> list[tuple[int, int, str]]:
    """Parts an episode into its rounds, each up to where the gripper lets go, with what was carried in it."""
    found, begin = [], 0
    for segment in segments_of(episode.closed):
        if segment.label:
            lifted = {body: float(h[segment.start : segment.end].max()) for body, h in episode.heights.items()}
            body, height = max(lifted.items(), key=lambda pair: pair[1])
            found.append((begin, segment.end, body if height > LIFTED_M else NOTHING))
            begin = segment.end
    return found


def score(episodes: Sequence[Episode], labels: Sequence[IntArray]) -> dict[str, object]:
    """Scores skills against the gripper, and tells whether rounds of the same work have the same skills."""
    closed = [episode.closed for episode in episodes]
    parts = [
        (episode.name, what, found[begin:end])
        for episode, found in zip(episodes, labels, strict=True)
        for begin, end, what in rounds(episode)
    ]
    words = [(name, what, [s for s in segments_of(part) if s.length >= BRIEF_S * FPS]) for name, what, part in parts]
    return {
        **asdict(agreement(labels, closed, FPS)),
        "n_skills": len(set(np.concatenate(labels).tolist())),
        "segments": [len(segments_of(found)) for found in labels],
        "gripper_segments": [len(segments_of(grip)) for grip in closed],
        "distance_of_rounds": label_distance(
            [np.array([s.label for s in w]) for _, what, w in words if what != NOTHING]
        ),
        "rounds": [[name, what, [s.label for s in word]] for name, what, word in words],
    }


def segment(name: str, root: Path, config: HumanConfig, seed: int, setting: str) -> list[IntArray]:
    """Discovers the skills of a dataset, with a representation that is trained once a seed."""
    representation = replace(REPRESENTATION, seed=seed)
    discovery = replace(SETTINGS[setting], seed=seed)
    found = discover_skills(root, representation, discovery, config.output / "segmentation" / f"{name}.{seed}")
    return found.labels


def main() -> None:
    """Does what is missing, prints a table and draws the pictures of the first seed."""
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
    config = draccus.parse(HumanConfig)
    output, pictures = config.output.absolute(), (config.pictures or config.output).absolute()
    results_file = output / "results.json"
    results: dict[str, dict[str, object]] = read_json(results_file) if results_file.exists() else {}
    found: dict[tuple[str, str], list[tuple[Episode, IntArray]]] = {}
    for name, recording in RECORDINGS.items():
        assets, root = fetch(recording.version, output / "wheels"), output / "datasets" / name
        import_recording(name, assets, root)
        episodes = truths(name, assets, root)
        for setting in SETTINGS:
            for seed in range(config.seeds):
                labels = segment(name, root, config, seed, setting)
                results[f"{name}, {setting}, seed {seed}"] = score(episodes, labels)
                write_json(results_file, results)
                if seed == 0:
                    found[name, setting] = list(zip(episodes, labels, strict=True))
    for name, setting in SHOWN.items():
        episode, labels = found[name, setting][0]
        draw_episode(pictures / f"human_{name}.png", episode, labels, FPS)
    for name, of in (("default", dict.fromkeys(RECORDINGS, "default")), ("ribbons", SHOWN)):
        draw_ribbons(pictures / f"human_{name}.png", [row for key in of.items() for row in found[key]], FPS)
    print(table(results, config.seeds))


def table(results: dict[str, dict[str, object]], seeds: int) -> str:
    """Formats the results, a row a task and setting: the mean over the seeds, and its range."""
    head = "boundary F1 | precision | recall | NMI | skills | segments (gripper's) | distance of rounds"
    lines = [f"| task | setting | {head} |", "|---" * 9 + "|"]
    for name in RECORDINGS:
        for setting in SETTINGS:
            rows = [results[f"{name}, {setting}, seed {seed}"] for seed in range(seeds)]
            cells = [_spread([float(str(row[key])) for row in rows]) for key in _SCORES]
            counts = "; ".join(str(sum(row["segments"])) for row in rows)  # type: ignore[call-overload]
            true = sum(rows[0]["gripper_segments"])  # type: ignore[call-overload]
            cells.insert(5, f"{counts} ({true})")
            lines.append(f"| {name} | {setting} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


_SCORES = ("boundary_f1", "boundary_precision", "boundary_recall", "nmi", "n_skills", "distance_of_rounds")


def _spread(values: list[float]) -> str:
    digits = 0 if all(value == int(value) and value > 1 for value in values) else 2
    if min(values) == max(values):
        return f"{values[0]:.{digits}f}"
    return f"{np.mean(values):.{digits}f} ({min(values):.{digits}f} to {max(values):.{digits}f})"


if __name__ == "__main__":
    main()
