"""Pictures of demonstrations, for looking before learning."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import IMAGE_PREFIX, TRUE_STAGE, write_atomically

from .frames import cached_frames
from .tables import DatasetFiles, read_table


def draw_contact_sheet(
    root: Path, path: Path, stages: tuple[str, ...] = (), columns: int = 6, cache_dir: Path | None = None
) -> None:
    """Draws every camera over the course of one demonstration, one row a camera and, where they are known, a stage.

    The demonstration shown is the one of median length.

    Args:
        root: Folder of a LeRobotDataset, whole on this machine.
        path: PNG file to write, atomically.
        stages: Names of the true stages; without them, the demonstration is shown as one.
        columns: Frames a row.
        cache_dir: Folder of the decoded frames; LeRobot's home where None.

    Raises:
        DatasetError: The dataset is damaged or incomplete.
    """
    cameras = [name for name in DatasetFiles(root).features if name.startswith(IMAGE_PREFIX)]
    table = read_table(root, [TRUE_STAGE] if stages else [])
    episode = int(np.argsort(table.ends - table.starts, kind="stable")[len(table.starts) // 2])
    start, end = int(table.starts[episode]), int(table.ends[episode])
    stage_of = table.columns[TRUE_STAGE][start:end] if stages else np.zeros(end - start, dtype=np.int64)
    rows = []
    for number in np.unique(stage_of).tolist():
        frames = start + np.flatnonzero(stage_of == number)
        shown = frames[np.linspace(0, len(frames) - 1, columns).round().astype(int)]
        for camera in cameras:
            label = camera.removeprefix(IMAGE_PREFIX)
            name = f"{stages[number]}\n{label}" if stages else label
            rows.append((name, shown, cached_frames(root, camera, cache_dir)[shown]))
    _draw(path, rows, start)


def _draw(path: Path, rows: list[tuple[str, NDArray[np.int64], NDArray[np.uint8]]], start: int) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = len(rows[0][1])
    figure = Figure(figsize=(1.5 * columns + 1.2, 1.65 * len(rows)), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(rows), columns, squeeze=False)
    for axes_row, (name, frames, images) in zip(grid, rows, strict=True):
        for axes, frame, image in zip(axes_row, frames, images, strict=True):
            axes.imshow(image.transpose(1, 2, 0))
            axes.set_title(f"frame {frame - start}", fontsize="x-small")
            axes.set_xticks([])
            axes.set_yticks([])
        axes_row[0].set_ylabel(name, rotation=0, ha="right", va="center", fontsize="small")
    write_atomically(path, lambda part: figure.savefig(part, format="png", metadata={"Software": None}))
