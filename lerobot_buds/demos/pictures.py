"""Pictures of demonstrations, for looking before learning."""

from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import IMAGE_PREFIX, TRUE_STAGE, BudsError, write_atomically
from lerobot_buds.data.dataset import LocalDataset
from lerobot_buds.data.frames import cached_frames
from lerobot_buds.data.tables import read_table

from .attempts import Attempt


def draw_contact_sheet(
    root: Path, path: Path, stages: tuple[str, ...] = (), columns: int = 4, cache_dir: Path | None = None
) -> None:
    """Draws the course of one demonstration, the one of median length: one row a stage, all cameras side by side.

    Args:
        root: Folder of a LeRobotDataset, whole on this machine.
        path: PNG file to write, atomically.
        stages: Names of the true stages; without them, the demonstration is shown as one.
        columns: Frames of each camera in a row.
        cache_dir: Folder of the frame store; in LeRobot's home where None.

    Raises:
        DatasetError: The dataset is damaged or incomplete.
    """
    table = read_table(root, [TRUE_STAGE] if stages else [])
    episode = int(np.argsort(table.ends - table.starts, kind="stable")[len(table.starts) // 2])
    shown = LocalDataset(root, chosen=(episode,))
    start, end = int(table.starts[episode]), int(table.ends[episode])
    stage_of = table.columns[TRUE_STAGE][start:end] if stages else np.zeros(end - start, dtype=np.int64)
    images = {
        camera.removeprefix(IMAGE_PREFIX): cached_frames(shown, camera, cache_dir)[start:end].transpose(0, 2, 3, 1)
        for camera in shown.cameras
    }
    _draw(path, images, stage_of, stages, columns)


def draw_attempt(attempt: Attempt, stages: tuple[str, ...], path: Path, columns: int = 4) -> None:
    """Draws one attempt like `draw_contact_sheet`.

    Raises:
        BudsError: It failed, so that there is nothing to see.
    """
    if not attempt.success:
        raise BudsError(f"The attempt from seed {attempt.seed} failed ({attempt.failure}); take another --seed.")
    images = {name: rows for name, rows in attempt.arrays.items() if rows.ndim == 4}
    path.parent.mkdir(parents=True, exist_ok=True)
    _draw(path, images, attempt.arrays["true_stage"][:, 0], stages, columns)


def _draw(
    path: Path,
    images: dict[str, NDArray[np.uint8]],
    stage_of: NDArray[np.int64],
    stages: tuple[str, ...],
    columns: int,
) -> None:
    """Draws the frames of every camera, (T, H, W, 3) each, by the stage of a frame, (T,)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    numbers = list(dict.fromkeys(stage_of.tolist()))  # in the order in which the stages were done
    width = columns * len(images)
    figure = Figure(figsize=(1.5 * width + 1.2, 1.65 * len(numbers) + 0.3), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(numbers), width, squeeze=False)
    for axes_row, number in zip(grid, numbers, strict=True):
        frames = np.flatnonzero(stage_of == number)
        shown = frames[np.linspace(0, len(frames) - 1, columns).round().astype(int)].tolist()
        for axes, (camera, frame) in zip(axes_row, product(images, shown), strict=True):
            axes.imshow(images[camera][frame])
            axes.set_title(f"{camera}, {frame}", fontsize="x-small")
            axes.set_xticks([])
            axes.set_yticks([])
        name = stages[number] if stages else "demonstration"
        axes_row[0].set_ylabel(name, rotation=0, ha="right", va="center", fontsize="small")
    write_atomically(path, lambda part: figure.savefig(part, format="png", metadata={"Software": None}))
