"""The picture of a run: every episode is a ribbon of coloured skills, with its stages and how it ended."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_buds.core import write_atomically
from lerobot_buds.segmentation.timeline import draw_rows, label_colors

from .insight import MANIPULATION, WRONG_SKILL, failures_of
from .trace import Episode, RolloutRecord

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ROW_INCHES, _MAX_ROWS_INCHES = 0.36, 24.0
_GOOD, _BAD, _LOST = "#1a7f37", "#c0392b", "0.45"
_VERDICTS = {WRONG_SKILL: "wrong skill", MANIPULATION: "manipulation", None: "failed"}


def draw_ribbons(path: Path, record: RolloutRecord) -> None:
    """Draws the skills of every episode as a PNG, atomically: successes first, then what came furthest.

    Args:
        path: The picture to create or replace.
        record: At least one episode that was not lost at its start.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = [pair for pair in zip(record.episodes, failures_of(record), strict=True) if pair[0].length]
    rows.sort(key=lambda row: _order(row[0]))
    episodes = [episode for episode, _ in rows]
    height = min(_ROW_INCHES * max(len(rows), 3), _MAX_ROWS_INCHES)
    figure = Figure(figsize=(11, height + 1.5), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    end = _last_second(episodes, record.fps)
    shown = [episode.labels[: round(end * record.fps)] for episode in episodes]
    draw_rows(axes, shown, record.fps, "skills", bottom=-0.22, top=0.36, names=range(record.n_skills))
    for row, (episode, failure) in enumerate(rows):
        _mark_row(axes, row, episode, failure, record.fps, end)
    _finish(figure, axes, record, episodes, end)
    write_atomically(path, lambda part: figure.savefig(part, format="png", metadata={"Software": None}))


def _order(episode: Episode) -> tuple[bool, int, int]:
    done = sum(step is not None for step in episode.stage_steps)
    return (not episode.success, 0 if episode.success else -done, episode.length)


def _last_second(episodes: Sequence[Episode], fps: float) -> float:
    """Chooses where the picture ends: hands that wander until the time limit must not squeeze all that matters."""
    whole = max(episode.length for episode in episodes)
    successes = [episode.length for episode in episodes if episode.success]
    telling = [int(1.5 * max(successes))] if successes else [whole]
    telling += [int(1.25 * episode.last_progress) for episode in episodes]
    return min(whole, max(telling)) / fps


def _mark_row(axes: "Axes", row: int, episode: Episode, failure: str | None, fps: float, end: float) -> None:
    """Marks when stages were done, and how the episode ended."""
    for number, step in enumerate(episode.stage_steps):
        if step is not None and step / fps <= end:
            axes.plot([step / fps] * 2, [row - 0.28, row + 0.36], color="black", linewidth=1.1, solid_capstyle="butt")
            axes.text(step / fps, row - 0.27, str(number + 1), ha="center", va="bottom", fontsize=6.5)
    if episode.error:
        word, color = "lost to an error", _LOST
    elif episode.success:
        word, color = "success", _GOOD
    else:
        word, color = _VERDICTS[failure], _BAD
    cut = episode.length / fps > end
    words = f"{word}, {episode.length / fps:.0f} s" if cut else word
    place = min(episode.length / fps, end)
    axes.annotate(
        ("… " if cut else "") + words,
        (place, row + 0.07),
        xytext=(5, 0),
        textcoords="offset points",
        va="center",
        fontsize="small",
        color=color,
        annotation_clip=False,
    )


def _finish(figure: "Figure", axes: "Axes", record: RolloutRecord, episodes: Sequence[Episode], end: float) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    axes.set_ylim(len(episodes) - 0.4, -0.7)
    axes.set_xlim(0, 1.2 * end)  # room for the verdicts
    axes.set_xlabel("time (s)")
    axes.set_ylabel("seed")
    every = max(1, round(len(episodes) / (_MAX_ROWS_INCHES / 0.2)))
    axes.set_yticks(range(0, len(episodes), every), [str(e.seed) for e in episodes[::every]], fontsize="small")
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color="0.88", linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    colors = label_colors(range(record.n_skills), "skills")
    handles: list[Patch | Line2D] = [Patch(color=color, label=f"skill {k}") for k, color in colors.items()]
    handles += [
        Line2D([], [], color="black", linewidth=1.1, label=f"{number}: {stage} done")
        for number, stage in enumerate(record.stages, start=1)
    ]
    figure.legend(handles=handles, loc="outside right upper", frameon=False, fontsize="small")
    whole = [episode.success for episode in episodes if not episode.error]
    title = f"{record.task}: {sum(whole)} of {len(whole)} episodes succeeded"
    axes.set_title(title, loc="left", fontsize="medium", fontweight="bold")
