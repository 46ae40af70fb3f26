"""Shows a comparison of segmentation methods: a table, and a picture of one demonstration under all of them."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_buds.core import IntArray, write_atomically
from lerobot_buds.segmentation.timeline import draw_rows

from .comparison import Result, seed_stability

_COLUMNS: tuple[tuple[str, Callable[[Result], float]], ...] = (
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
        for name, value in _COLUMNS:
            values = [float(value(r)) for r in of_method]
            row[name] = {"mean": float(np.mean(values)), "low": min(values), "high": max(values)}
        row["seed stability"] = seed_stability(of_method)
        row["segments of skills"] = of_method[0].skills
        rows.append(row)
    return rows


def comparison_table(results: Sequence[Result]) -> str:
    """Formats the means as a table in Markdown; a range follows where the seeds differ by 0.05 or more."""
    names = [name for name, _ in _COLUMNS]
    lines = [
        f"| method | {' | '.join(names)} | seed stability |",
        "|---" * (len(names) + 2) + "|",
    ]
    for row in comparison_rows(results):
        cells = []
        for name in names:
            score = row[name]
            spread = f" ({score['low']:.2f} to {score['high']:.2f})" if score["high"] - score["low"] >= 0.05 else ""
            cells.append(f"{score['mean']:.2f}{spread}")
        lines.append(f"| {row['method']} | {' | '.join(cells)} | {row['seed stability']:.2f} |")
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
