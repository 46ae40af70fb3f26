"""Shows a comparison of segmentation methods: a table, and a picture of one demonstration under all of them."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_buds.core import IntArray, write_atomically
from lerobot_buds.segmentation.timeline import draw_rows

from .comparison import Result, seed_stability

Columns = tuple[tuple[str, Callable[[Result], float]], ...]

_COLUMNS: Columns = (
    ("boundary F1", lambda r: r.scores.boundary_f1),
    ("precision", lambda r: r.scores.boundary_precision),
    ("recall", lambda r: r.scores.boundary_recall),
    ("segment F1", lambda r: r.scores.segment_f1),
    ("NMI", lambda r: r.scores.nmi),
    ("ARI", lambda r: r.scores.ari),
    ("label distance", lambda r: r.label_distance),
    ("skills", lambda r: r.n_skills),
    ("segments", lambda r: r.segments),
    ("seconds", lambda r: r.seconds),
)
_PERCENT: Columns = (
    ("F1@10", lambda r: r.matched.f1_10),
    ("F1@25", lambda r: r.matched.f1_25),
    ("F1@50", lambda r: r.matched.f1_50),
    ("Edit", lambda r: r.matched.edit),
    ("MoF", lambda r: r.matched.mof),
    ("mIoU", lambda r: r.matched.miou),
)


def by_method(results: Sequence[Result]) -> dict[str, list[Result]]:
    """Groups results by method, in the order of their appearance."""
    groups: dict[str, list[Result]] = {}
    for result in results:
        groups.setdefault(result.method, []).append(result)
    return groups


def comparison_rows(results: Sequence[Result]) -> list[dict[str, Any]]:
    """Averages every score of every method over the seeds, as plain data.

    Returns:
        One mapping a method: its name, each column's mean and range, the stability over seeds, and the number and mean
        length of the segments of every skill (first seed).
    """
    rows: list[dict[str, Any]] = []
    for method, of_method in by_method(results).items():
        row: dict[str, Any] = {"method": method, "seeds": [r.seed for r in of_method]}
        for name, value in (*_COLUMNS, *_PERCENT):
            values = [float(value(r)) for r in of_method]
            row[name] = {"mean": float(np.mean(values)), "low": min(values), "high": max(values)}
        row["seed stability"] = seed_stability(of_method)
        row["segments of skills"] = of_method[0].skills
        rows.append(row)
    return rows


def comparison_table(results: Sequence[Result]) -> str:
    """Formats the means as two tables in Markdown, the second of what papers print of matched labels, in percent.

    A range follows where the seeds differ by 0.05 or more, or 5 %.
    """
    rows = comparison_rows(results)
    first = _table(rows, [name for name, _ in _COLUMNS], digits=2, notable=0.05, last=("seed stability",))
    return f"{first}\n{_table(rows, [name for name, _ in _PERCENT], digits=1, notable=5.0)}"


def _table(
    rows: Sequence[dict[str, Any]], names: Sequence[str], digits: int, notable: float, last: Sequence[str] = ()
) -> str:
    """One line a method; columns in `last` have no range."""

    def cell(score: dict[str, float]) -> str:
        low, high = (f"{score[end]:.{digits}f}" for end in ("low", "high"))
        spread = f" ({low} to {high})" if score["high"] - score["low"] >= notable else ""
        return f"{score['mean']:.{digits}f}{spread}"

    lines = [f"| method | {' | '.join([*names, *last])} |", "|---" * (1 + len(names) + len(last)) + "|"]
    for row in rows:
        cells = [cell(row[name]) for name in names] + [f"{row[name]:.{digits}f}" for name in last]
        lines.append(f"| {row['method']} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def draw_comparison(path: Path, results: Sequence[Result], stages: Sequence[IntArray], fps: float) -> None:
    """Draws the demonstration of median length under every method (first seed), above its true stages.

    Args:
        path: PNG file to write, atomically.
        results: What was compared.
        stages: ``(T,)`` true stages of every demonstration.
        fps: Frames per second.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    groups = by_method(results)
    shown = int(np.argsort([len(episode) for episode in stages], kind="stable")[len(stages) // 2])
    figure = Figure(figsize=(11, 0.36 * (len(groups) + 1) + 0.9), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for row, of_method in enumerate(groups.values()):
        draw_rows(axes, [of_method[0].labels[shown]], fps, "skills", bottom=row - 0.4, top=row + 0.4)
    draw_rows(axes, [stages[shown]], fps, "stages", bottom=len(groups) - 0.4, top=len(groups) + 0.4)
    axes.set_yticks(range(len(groups) + 1), [*groups, "(stages of the script)"])
    axes.set_ylim(len(groups) + 0.6, -0.6)
    axes.set_xlim(0, len(stages[shown]) / fps)
    axes.set_xlabel("time (s)")
    axes.set_title(f"demonstration {shown}: skills found by each method; colours mean nothing across rows", loc="left")
    write_atomically(path, lambda part: figure.savefig(part, format="png", metadata={"Software": None}))
