"""The main job: one real task, from scripted demonstrations to an evaluated policy, in one table.

Every stage runs one of the public commands. A stage that is done is skipped, an interrupted one goes on where it was,
so the script can be interrupted and run again at any time. Everything is written to ``outputs/demo``.
"""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from lerobot_buds.core import COLLECTION_FILE, CONTACT_SHEET_FILE, read_json, write_json
from lerobot_buds.evaluation import read_success_rate
from lerobot_buds.experiments import demo_table
from lerobot_buds.segmentation import SegmentationRecord

OUT = Path("outputs/demo")
DEMONSTRATIONS, SEGMENTED = OUT / "demonstrations", OUT / "segmented"
TRAINING, EVALUATION = OUT / "training", OUT / "evaluation"
TIMES = OUT / "seconds.json"
REPO_ID = "local/close_and_serve"
EPISODES, STEPS, TRIALS = 40, 1000, 20
FIRST_EVALUATION_SEED = 500_000
LONGEST_EPISODE = 400

# LeRobot's loader decodes in workers: with one thread each, the two cores do not fight over the network.
ONE_THREAD = {"OMP_NUM_THREADS": "1"}


@dataclass(frozen=True)
class Stage:
    """One step of the demo.

    Attributes:
        name: Its name in the table.
        command: Makes the command line.
        result: Exists when the stage is done.
        figure: Describes the result in a few words.
        environment: Variables to set.
    """

    name: str
    command: Callable[[], list[str]]
    result: Path
    figure: Callable[[], str]
    environment: dict[str, str] = field(default_factory=dict)


def collect() -> list[str]:
    """Records the demonstrations."""
    return [
        "lerobot-buds-collect",
        f"--repo_id={REPO_ID}",
        f"--root={DEMONSTRATIONS}",
        f"--episodes={EPISODES}",
    ]


def segment() -> list[str]:
    """Discovers the skills."""
    return [
        "lerobot-buds-segment",
        "--config_path=configs/segment_demo.yaml",
        f"--repo_id={REPO_ID}",
        f"--root={DEMONSTRATIONS}",
        f"--output_root={SEGMENTED}",
        f"--work_dir={OUT / 'segmentation'}",
    ]


def train() -> list[str]:
    """Trains the policy, from the last checkpoint if there is one."""
    last = TRAINING / "checkpoints" / "last" / "pretrained_model" / "train_config.json"
    if last.exists():
        return ["lerobot-train", f"--config_path={last}", "--resume=true"]
    shutil.rmtree(TRAINING, ignore_errors=True)  # interrupted before the first checkpoint
    return [
        "lerobot-train",
        "--config_path=configs/train_demo.yaml",
        f"--dataset.repo_id={REPO_ID}_skills",
        f"--dataset.root={SEGMENTED}",
        f"--output_dir={TRAINING}",
        f"--steps={STEPS}",
    ]


def evaluate() -> list[str]:
    """Rolls the policy out in the environment of the demonstrations, on seeds that they never used."""
    return [
        "lerobot-eval",
        f"--policy.path={TRAINING / 'checkpoints' / 'last' / 'pretrained_model'}",
        "--policy.device=cpu",
        "--env=include configs/env/multitask_kitchen_task3_variant1.yaml",
        f"--env.episode_length={LONGEST_EPISODE}",
        f"--eval.n_episodes={TRIALS}",
        "--eval.batch_size=2",
        f"--seed={FIRST_EVALUATION_SEED}",
        f"--output_dir={EVALUATION}",
    ]


def demonstrations_figure() -> str:
    """Counts demonstrations, frames and failed attempts."""
    info, record = read_json(DEMONSTRATIONS / "meta/info.json"), read_json(DEMONSTRATIONS / COLLECTION_FILE)
    failed = sum(len(task["failed_attempts"]) for task in record["tasks"])
    return f"{info['total_episodes']} demonstrations, {info['total_frames']} frames, {failed} failed attempts"


def segmentation_figure() -> str:
    """Names the number of skills and the agreement with the demonstrator's stages."""
    record = SegmentationRecord.read(SEGMENTED)
    scores = record.agreement or {}
    found = f"recall {scores['boundary_recall']:.2f}, precision {scores['boundary_precision']:.2f}"
    return f"{record.n_skills} skills; true boundaries: {found}; NMI {scores['nmi']:.2f}"


STAGES = (
    Stage("collect", collect, DEMONSTRATIONS, demonstrations_figure),
    Stage("segment", segment, SEGMENTED, segmentation_figure),
    Stage("train", train, TRAINING / f"checkpoints/{STEPS:06d}/training_state", lambda: f"{STEPS} steps", ONE_THREAD),
    Stage(
        "evaluate",
        evaluate,
        EVALUATION / "eval_info.json",
        lambda: str(read_success_rate(EVALUATION / "eval_info.json")),
        ONE_THREAD,
    ),
)


def run(stage: Stage, seconds: dict[str, float]) -> None:
    """Runs a stage that is not done, and adds its time to those of earlier, interrupted runs."""
    if stage.result.exists():
        return
    command = stage.command()
    print(f"\n== {stage.name}: {' '.join(command)}", flush=True)
    program = Path(sys.executable).with_name(command[0])  # of this very environment, whatever the PATH says
    began = time.monotonic()
    environment = os.environ | {"HF_HUB_OFFLINE": "1"}  # everything is local: LeRobot need not ask the Hub
    try:
        subprocess.run([program, *command[1:]], check=True, env=environment | stage.environment)
    finally:
        seconds[stage.name] = seconds.get(stage.name, 0.0) + time.monotonic() - began
        write_json(TIMES, seconds)


def show(seconds: dict[str, float]) -> None:
    """Prints the table and where the pictures are, and keeps the table for README (``docs/results/demo.json``)."""
    stages = [
        {"stage": stage.name, "seconds": round(seconds.get(stage.name, 0.0)), "figure": stage.figure()}
        for stage in STAGES
    ]
    write_json(OUT / "demo.json", stages)
    print(f"\n{demo_table(stages)}")
    videos = sorted((EVALUATION / "videos").rglob("*.mp4"))
    drawn = [OUT / "segmentation/timeline.png", OUT / "segmentation/reconstructions.png"]
    pictures = [DEMONSTRATIONS / CONTACT_SHEET_FILE, *drawn]
    print("\npictures: " + "\n          ".join(str(path) for path in [*pictures, *videos[:1]]))


def main() -> None:
    """Runs every stage that is not done yet."""
    OUT.mkdir(parents=True, exist_ok=True)
    seconds: dict[str, float] = json.loads(TIMES.read_text()) if TIMES.exists() else {}
    try:
        for stage in STAGES:
            run(stage, seconds)
    except subprocess.CalledProcessError as error:
        sys.exit(f"{Path(error.cmd[0]).name} failed (status {error.returncode}); run again to go on")
    except KeyboardInterrupt:
        sys.exit("interrupted; run again to go on")
    show(seconds)


if __name__ == "__main__":
    main()
