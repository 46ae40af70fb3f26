"""Pictures of experiments: the paper's bars beside ours."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from lerobot_buds.core import write_atomically

from .experiment import Experiment, Size
from .results import Pooled

PAPER_COLOUR, OUR_COLOURS = "#b8b8b8", ("#2b6cb0", "#c05621", "#2f855a")


def draw_experiment(
    path: Path, experiment: Experiment, sizes: Sequence[Size], results: Mapping[tuple[str, str, str], Pooled]
) -> None:
    """Draws a panel a row and a group of bars a method; the paper's with its spread, ours with the 95 % interval.

    Args:
        path: PNG file to write, atomically.
        experiment: What is drawn.
        sizes: Sizes to draw, where there are results.
        results: By size, row and method.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = [size for size in sizes if any(key[0] == size.name for key in results)]
    rows = experiment.rows
    width = max(3.0, 0.95 * len(experiment.methods)) * len(rows)
    figure = Figure(figsize=(max(5.0, width), 3.4), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(rows), sharey=True, squeeze=False)[0]
    step = 0.8 / (1 + len(shown))
    for axes, row in zip(panels, rows, strict=True):
        cells = [cell for cell in experiment.cells if cell.row == row]
        for x, cell in enumerate(cells):
            if cell.published is not None:
                mean, spread = cell.published
                axes.bar(x - 0.4 + step / 2, mean, step, yerr=spread, color=PAPER_COLOUR, capsize=2)
            for n, size in enumerate(shown, start=1):
                pooled = results.get((size.name, row, cell.method))
                if pooled is not None:
                    rate, at = pooled.rate, x - 0.4 + step * (n + 0.5)
                    error = [[100 * (rate.rate - rate.low)], [100 * (rate.high - rate.rate)]]
                    axes.bar(at, 100 * rate.rate, step, yerr=error, color=OUR_COLOURS[n - 1], capsize=2)
        axes.set_xticks(range(len(cells)), [cell.method.replace(" (", "\n(").replace(", ", ",\n") for cell in cells])
        axes.set_xlim(-0.6, len(cells) - 0.4)
        axes.set_title(row, fontsize=10)
        axes.set_ylim(0, 105)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("success (%)")
    names = [*(["paper"] if any(cell.published for cell in experiment.cells) else []), *(size.title for size in shown)]
    colours = [*([PAPER_COLOUR] if names[0] == "paper" else []), *OUR_COLOURS]
    handles = [axes.bar(0, 0, color=colour, label=name) for name, colour in zip(names, colours, strict=False)]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8, frameon=False)
    write_atomically(path, lambda part: figure.savefig(part, format="png", metadata={"Software": None}))
