"""What a recorded frame costs: simulated and drawn, written as images and as video, and by the whole command."""

import time
from collections.abc import Iterator
from pathlib import Path

from lerobot_buds.cli.collect import CollectConfig, collect
from lerobot_buds.core import ACTION, IMAGE_PREFIX, STATE
from lerobot_buds.data.parts import write_part
from lerobot_buds.demos.attempts import Attempt, Style, attempt_in_worker
from lerobot_buds.demos.recording import features_of
from lerobot_buds.envs import CAMERAS, FPS, EnvSettings

from .figures import Figure, Setting, alone

TASK = "tool_use/cube_fetched"
SIMULATED = "simulated and drawn"
UNIT = "ms of CPU a frame"


def measure(setting: Setting) -> Iterator[Figure]:
    """Simulates some demonstrations and writes them in both ways, then records as many by the command."""
    count, pixels = setting.size.recorded, setting.size.pixels
    attempts, seconds = alone(_simulated, count, pixels)
    frames = sum(len(attempt.arrays[ACTION]) for attempt in attempts)
    yield Figure(SIMULATED, 1e3 * seconds / frames, UNIT)
    for kind in ("images", "video"):
        _write(attempts[0], pixels, kind == "video", setting.place / "first")  # what it takes is imported here
        began = time.process_time()
        for attempt in attempts:
            _write(attempt, pixels, kind == "video", setting.place / "written")
        yield Figure(f"written as {kind}", 1e3 * (time.process_time() - began) / frames, UNIT, SIMULATED)
    for workers in (1, 2)[: setting.size.recorded]:
        root, start = setting.place / f"recorded_{workers}", time.perf_counter()
        wanted = {"task": TASK, "episodes": count, "image_size": pixels, "video": False, "workers": workers}
        made = collect(CollectConfig("local/recorded", root=root, **wanted))
        rate = made.frames / (time.perf_counter() - start)
        against = "the command, 1 process" if workers > 1 else ""
        yield Figure(f"the command, {workers} process{'es' if workers > 1 else ''}", rate, "frames/s", against)


def _simulated(count: int, pixels: int) -> tuple[list[Attempt], float]:
    """Runs attempts; returns them, and the time (s of CPU)."""
    began = time.process_time()
    attempts = [attempt_in_worker(EnvSettings(TASK, image_size=pixels), seed, Style()) for seed in range(count)]
    return attempts, time.process_time() - began


def _write(attempt: Attempt, pixels: int, video: bool, place: Path) -> None:
    features = features_of(pixels, video)
    columns = {
        **{IMAGE_PREFIX + camera: attempt.arrays[camera] for camera in CAMERAS},
        STATE: attempt.arrays["agent_pos"],
        ACTION: attempt.arrays[ACTION],
    }
    folder = place / f"{'video' if video else 'images'}_{attempt.seed}"
    write_part(folder, "local/part", FPS, features, columns, "fetch the cube", encoder_threads=1)
