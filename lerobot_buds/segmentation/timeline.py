"""Timeline picture: every demonstration is a row of coloured skills, with a thin strip of its true stages below."""

from collections.abc import Sequence
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING

import numpy as np

from lerobot_buds.core import DatasetError, IntArray, segments_of, write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Color = tuple[float, float, float, float]

_ROW_INCHES = 0.3
_MAX_ROWS_INCHES = 24.0
_LONGEST_NAME = 40  # characters


def draw_timeline(
    path: Path,
    labels: Sequence[IntArray],
    fps: float,
    true_stages: Sequence[IntArray] | None = None,
    title: str = "Skills of every demonstration",
    names: Sequence[str] | None = None,
) -> None:
    """Draws the segmentation of a dataset as a PNG, atomically.

    Args:
        path: The picture to create or replace.
        labels: ``(T,)`` skill of every frame, per demonstration.
        fps: Frame rate (frames per second).
        true_stages: ``(T,)`` true stage of every frame, per demonstration, where these are known.
        title: Title of the picture.
        names: Names of the skills, by their numbers, where there are any.

    Raises:
        DatasetError: Labels and true stages are not of the same demonstrations.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    if true_stages is not None and [len(s) for s in true_stages] != [len(e) for e in labels]:
        raise DatasetError("Timeline: labels and true stages differ in the number of demonstrations or of frames.")
    rows = min(_ROW_INCHES * max(len(labels), 3), _MAX_ROWS_INCHES)
    figure = Figure(figsize=(11, rows + 1.4), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    split = 0.42 if true_stages is None else 0.22  # where the bars of skills end, below the centre of their row
    draw_rows(axes, labels, fps, "skills", bottom=-0.42, top=split)
    if true_stages is not None:
        draw_rows(axes, true_stages, fps, "stages", bottom=split + 0.04, top=0.42)
    _finish(figure, axes, labels, true_stages, title, names)
    write_atomically(path, lambda part: figure.savefig(part, format="png", metadata={"Software": None}))


def draw_rows(
    axes: "Axes",
    episodes: Sequence[IntArray],
    fps: float,
    kind: str,
    bottom: float,
    top: float,
    names: Sequence[int] | None = None,
) -> None:
    """Draws the runs of demonstrations as bars, one row each.

    Args:
        axes: Where to draw, time in seconds along x.
        episodes: ``(T,)`` labels of every demonstration.
        fps: Frame rate (frames per second).
        kind: ``skills`` (hues) or ``stages`` (greys).
        bottom: Lower edge of the bars, relative to the row's number.
        top: Upper edge of them.
        names: All labels that there are, for the choice of colours; None for those that occur.
    """
    colors = label_colors(_occurring(episodes) if names is None else names, kind)
    for row, episode in enumerate(episodes):
        runs = segments_of(episode)
        axes.broken_barh(
            [(run.start / fps, run.length / fps) for run in runs],
            (row + bottom, top - bottom),
            facecolors=[colors[run.label] for run in runs],
            edgecolor="white",
            linewidth=0.6 if kind == "skills" else 0.0,
        )


def _finish(
    figure: "Figure",
    axes: "Axes",
    labels: Sequence[IntArray],
    stages: Sequence[IntArray] | None,
    title: str,
    names: Sequence[str] | None,
) -> None:
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    axes.set_ylim(len(labels) - 0.4, -0.6)  # the first demonstration is on top
    axes.set_xlim(left=0)
    axes.margins(x=0.01)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("demonstration")
    axes.yaxis.set_major_locator(MaxNLocator(nbins=20, integer=True, min_n_ticks=1))
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color="0.88", linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    skill_colors = label_colors(_occurring(labels), "skills")
    handles = [Patch(color=color, label=_called(k, names)) for k, color in skill_colors.items()]
    if stages is not None:
        stage_colors = label_colors(_occurring(stages), "stages")
        handles += [Patch(color=color, label=f"true stage {k}") for k, color in stage_colors.items()]
    legend = figure.legend(handles=handles, loc="outside right upper", frameon=False, fontsize="small")
    for text in legend.get_texts():
        text.set_parse_math(False)  # names are anybody's: a $ is a $
    axes.set_title(title, loc="left", fontsize="medium", fontweight="bold")


def _called(skill: int, names: Sequence[str] | None) -> str:
    """Calls a skill by its number and, where it has one, its name; automatic names begin with the number."""
    number = f"skill {skill}"
    if names is None or not names[skill].strip():
        return number
    name = shorten(names[skill], _LONGEST_NAME, placeholder=" ...")
    return name if name.startswith(f"{number}:") else f"{number}: {name}"


def _occurring(episodes: Sequence[IntArray]) -> list[int]:
    names: list[int] = np.unique(np.concatenate(episodes)).tolist()
    return names


def label_colors(names: Sequence[int], kind: str) -> dict[int, Color]:
    """Chooses one colour per label: hues for skills, greys for stages, so that nobody reads a stage as a skill.

    Args:
        names: The labels, ascending.
        kind: ``skills`` or ``stages``.

    Returns:
        Label to red, green, blue and opacity, in [0, 1].
    """
    from matplotlib import colormaps

    if kind == "stages":
        return {k: colormaps["Greys"](x) for k, x in zip(names, np.linspace(0.3, 0.85, len(names)), strict=True)}
    if len(names) <= 20:
        palette = colormaps["tab10" if len(names) <= 10 else "tab20"]
        return {k: palette(i) for i, k in enumerate(names)}
    return {k: colormaps["turbo"](x) for k, x in zip(names, np.linspace(0.03, 0.97, len(names)), strict=True)}
