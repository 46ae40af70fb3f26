"""Picture of how the number of skills was chosen."""

from collections.abc import Mapping
from pathlib import Path

from lerobot_buds.core import write_atomically

from .selection import best_count


def draw_silhouettes(path: Path, scores: Mapping[int, float]) -> None:
    """Draws how well each number of clusters parts the segments as a PNG, atomically; the best one is marked.

    Args:
        path: The picture to create or replace.
        scores: Silhouette of every number of clusters, at least one.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 3.2), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    counts = sorted(scores)
    best = best_count(scores)
    axes.plot(counts, [scores[count] for count in counts], marker="o", color="0.45")
    axes.plot([best], [scores[best]], marker="o", markersize=10, color="C0")
    axes.annotate(f"{best} clusters", (best, scores[best]), xytext=(0, 10), textcoords="offset points", ha="center")
    axes.set_xticks(counts)
    axes.margins(y=0.25)
    axes.set_xlabel("clusters of temporal segments")
    axes.set_ylabel("silhouette")
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_title("Choice of the number of skills", loc="left", fontsize="medium", fontweight="bold")
    write_atomically(path, lambda part: figure.savefig(part, format="png", metadata={"Software": None}))
