"""Pictures of human demonstrations: what both cameras saw over the skills that were found and what the gripper did."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import IMAGE_PREFIX, IntArray, segments_of, write_atomically
from lerobot_buds.data import cached_frames
from lerobot_buds.segmentation.timeline import label_colors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH, DPI = 12.0, 100
THUMBNAILS = 10
_CLOSED, _OPEN = "#33373d", "#d9dce1"
_COLORS = 255


@dataclass(frozen=True)
class Episode:
    """What a person did in one episode.

    Attributes:
        name: Its name.
        root: Folder of its dataset.
        start: Absolute index of its first frame.
        end: One past its last frame.
        closed: ``(T,)`` int64, 1 where the gripper was told to be closed.
        heights: How much higher than at the start things are (m), ``(T,)`` by their name.
    """

    name: str
    root: Path
    start: int
    end: int
    closed: IntArray
    heights: dict[str, NDArray[np.float64]]


def draw_episode(path: Path, episode: Episode, labels: IntArray, fps: float) -> None:
    """Draws one episode: thumbnails of both cameras, the ribbon of skills, the gripper, and how high things are."""
    figure = _figure(4.3)
    grid = figure.add_gridspec(
        5, 1, height_ratios=[1.0, 1.0, 0.42, 0.2, 0.75], hspace=0.06, left=0.085, right=0.995, top=0.99, bottom=0.105
    )
    for row, camera in enumerate(("agentview", "eye_in_hand")):
        _thumbnails(figure.add_subplot(grid[row]), episode, camera)
    seconds = len(labels) / fps
    skills, gripper, heights = (figure.add_subplot(grid[row]) for row in (2, 3, 4))
    _ribbon(skills, labels, fps)
    _gripper(gripper, episode, fps)
    for axes, name in ((skills, "skill found"), (gripper, "gripper closed")):
        axes.set_ylabel(name, rotation=0, ha="right", va="center", fontsize=9)
        axes.set_xticks([])
    _heights(heights, episode, fps)
    for axes in (skills, gripper, heights):
        axes.set_xlim(0, seconds)
    _save(figure, path)


def draw_ribbons(path: Path, episodes: Sequence[tuple[Episode, IntArray]], fps: float) -> None:
    """Draws several episodes: of each, the ribbon of skills with the gripper below it."""
    figure = _figure(0.62 * len(episodes) + 0.65)
    longest = max(len(labels) for _, labels in episodes) / fps
    axes_of = figure.subplots(len(episodes), 1, sharex=True, squeeze=False)[:, 0]
    figure.subplots_adjust(hspace=0.25, left=0.14, right=0.995, top=0.98, bottom=0.5 / figure.get_size_inches()[1])
    for axes, (episode, labels) in zip(axes_of, episodes, strict=True):
        _ribbon(axes, labels, fps)
        _gripper(axes, episode, fps, top=-0.06, height=0.3)
        axes.set_ylim(-0.4, 1.0)
        axes.set_ylabel(episode.name.replace("_", " "), rotation=0, ha="right", va="center", fontsize=9)
        axes.set_xlim(0, longest)
        axes.tick_params(axis="x", length=0)
    axes_of[-1].set_xlabel("time (s)", fontsize=9)
    _save(figure, path)


def _figure(height: float) -> "Figure":
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, height), dpi=DPI)
    FigureCanvasAgg(figure)
    return figure


def _thumbnails(axes: "Axes", episode: Episode, camera: str) -> None:
    """Puts frames side by side, each the middle one of the time that it covers in the ribbon below."""
    frames = cached_frames(episode.root, IMAGE_PREFIX + camera)
    times = np.linspace(episode.start, episode.end, THUMBNAILS, endpoint=False) + len(episode.closed) / THUMBNAILS / 2
    images = [np.asarray(frames[int(t)]).transpose(1, 2, 0) for t in times]
    axes.imshow(np.concatenate(images, axis=1), extent=(0, THUMBNAILS, 0, 1), aspect="auto", interpolation="lanczos")
    for edge in range(1, THUMBNAILS):
        axes.axvline(edge, color="white", linewidth=1.2)
    axes.set_ylabel(
        camera.replace("_", " ").replace("agentview", "workspace"), rotation=0, ha="right", va="center", fontsize=9
    )
    _bare(axes)


def _ribbon(axes: "Axes", labels: IntArray, fps: float) -> None:
    names: list[int] = np.unique(labels).tolist()
    colors = label_colors(names, "skills")
    for segment in segments_of(labels):
        axes.broken_barh(
            [(segment.start / fps, segment.length / fps)], (0, 1), facecolor=colors[segment.label], edgecolor="white"
        )
        axes.text(
            (segment.start + segment.length / 2) / fps,
            0.5,
            str(segment.label),
            ha="center",
            va="center",
            color="white",
            fontsize=9,
            fontweight="bold",
            clip_on=True,
        )
    axes.set_ylim(0, 1)
    _bare(axes)


def _gripper(axes: "Axes", episode: Episode, fps: float, top: float = 1.0, height: float = 1.0) -> None:
    for segment in segments_of(episode.closed):
        axes.broken_barh(
            [(segment.start / fps, segment.length / fps)],
            (top - height, height),
            facecolor=_CLOSED if segment.label else _OPEN,
        )
    if height == 1.0:
        axes.set_ylim(0, 1)
    _bare(axes)


def _heights(axes: "Axes", episode: Episode, fps: float) -> None:
    time = np.arange(len(episode.closed)) / fps
    for number, (body, height) in enumerate(sorted(episode.heights.items())):
        color = ("#1f4e9c", "#b3541e", "#2f7d32", "#8e2457")[number % 4]
        axes.plot(time, height, color=color, linewidth=1.3)
        peak = int(np.argmax(height))
        axes.annotate(
            body.rstrip("0").removesuffix("_main"),
            (time[peak], height[peak]),
            xytext=(0, 2),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color=color,
        )
    low, high = min(h.min() for h in episode.heights.values()), max(h.max() for h in episode.heights.values())
    axes.set_ylim(low - 0.02, high * 1.3)
    axes.set_ylabel("lift (m)", rotation=0, ha="right", va="center", fontsize=9)
    axes.set_xlabel("time (s)", fontsize=9, labelpad=1)
    axes.tick_params(labelsize=8, length=2)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for segment in segments_of(episode.closed)[1:]:
        axes.axvline(segment.start / fps, color="0.8", linewidth=0.8, zorder=0)


def _bare(axes: "Axes") -> None:
    axes.set_yticks([])
    if not axes.get_shared_x_axes().get_siblings(axes)[1:]:
        axes.set_xticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)


def _save(figure: "Figure", path: Path) -> None:
    """Writes a PNG of few colours, which is a third of the size and looks the same."""
    from PIL import Image

    canvas: Any = figure.canvas
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    small = picture.quantize(_COLORS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    write_atomically(path, lambda part: small.save(part, format="png", optimize=True))
