"""The tables of one experiment, in Markdown: the paper's figures beside ours, how sure they are, what was not run."""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from lerobot_buds.evaluation.insight import MANIPULATION, WRONG_SKILL

from .experiment import Cell, Experiment, Size
from .results import Paired, Pooled, paired

type Results = Mapping[tuple[str, str, str], Pooled]
"""Name of the size, row and method -> all trainings of that cell."""


def size_section(experiment: Experiment, size: Size, results: Results) -> str:
    """Writes all that was found at one size; nothing where nothing was."""
    keys = {(size.name, cell.row, cell.method): cell for cell in experiment.cells}
    cells = [(cell, results[key]) for key, cell in keys.items() if key in results]
    if not cells:
        return ""
    lines = [
        f"### {size.title}\n",
        "| row | method | paper | ours | successes | training seeds | steps | minutes | skills | machine |",
        "|---|---|---|---|---|---|---|---|---|---|",
        *(_line(cell, pooled) for cell, pooled in cells),
        "",
        *_orders(experiment, size, results),
        *_pairs(experiment, size, results),
        *_failures(experiment, cells),
    ]
    return "\n".join(lines) + "\n"


def _line(cell: Cell, pooled: Pooled) -> str:
    rate, first = pooled.rate, pooled.results[0]
    minutes = sum(result.seconds["train"] for result in pooled.results) / len(pooled.results) / 60
    skills = sorted({r.segmentation["n_skills"] for r in pooled.results if r.segmentation})
    columns = [
        cell.row,
        cell.method,
        published_text(cell.published),
        f"**{pooled.mean:.1f}**" + ("" if pooled.spread is None else f" ± {pooled.spread:.1f}"),
        f"{rate.successes} of {rate.episodes} ({rate.low:.0%} to {rate.high:.0%})",
        ", ".join(map(str, pooled.seeds)),
        f"{first.steps:,}",
        f"{minutes:.1f}",
        ", ".join(map(str, skills)),
        ", ".join(sorted({result.machine for result in pooled.results})),
    ]
    return f"| {' | '.join(columns)} |"


def published_text(figures: Sequence[float | None] | None) -> str:
    """Writes mean and spread as the paper does; nothing where it has none."""
    if figures is None:
        return ""
    mean, spread = figures
    return f"{mean:.1f}" if spread is None else f"{mean:.1f} ± {spread:.1f}"


def _orders(experiment: Experiment, size: Size, results: Results) -> list[str]:
    """Says of every row whether methods rank as in the paper, once all that the paper has is there."""
    lines = []
    for row in experiment.rows:
        published = {c.method: c.published[0] for c in experiment.cells if c.row == row and c.published is not None}
        means = {m: results[size.name, row, m].mean for m in published if (size.name, row, m) in results}
        if len(published) < 2 or len(means) < len(published):
            continue
        theirs, ours = (sorted(figures, key=lambda m, f=figures: -f[m]) for figures in (published, means))  # type: ignore[misc]
        found = ", ".join(f"{method} ({means[method]:.0f})" for method in ours)
        lines.append(f"- {row}, from best to worst: {found}; {_likeness(theirs, means)} ({', '.join(theirs)}).")
    return [*lines, ""] if lines else []


def _likeness(theirs: Sequence[str], means: Mapping[str, float]) -> str:
    """Says whether methods that the paper ranks so have falling means."""
    falls = [means[better] - means[worse] for better, worse in pairwise(theirs)]
    if min(falls) < 0:
        return "not as in the paper"
    return "as in the paper" if min(falls) > 0 else "as in the paper but for ties"


def _pairs(experiment: Experiment, size: Size, results: Results) -> list[str]:
    """Compares the table's reference with the others on the same episodes, row by row and over all rows."""
    lines, reference = [], experiment.reference
    for method in experiment.methods:
        found: list[Paired] = []
        for row in experiment.rows:
            mine, other = (results.get((size.name, row, m)) for m in (reference, method))
            if method != reference and mine is not None and other is not None:
                found.append(paired(mine, other))
                lines += _pair(row, f"{reference} and {method}", found[-1])
        if len(found) > 1:
            lines += _pair("all rows", f"{reference} and {method}", sum(found[1:], start=found[0]))
    if not lines:
        return []
    head = "| row | on the same episodes | episodes | first alone | second alone | McNemar's p |"
    return [head, "|---" * 6 + "|", *lines, ""]


def _pair(row: str, methods: str, pair: Paired) -> list[str]:
    columns = [row, methods, pair.episodes, pair.first_alone, pair.second_alone, f"{pair.p_value:.2g}"]
    return [f"| {' | '.join(map(str, columns))} |"] if pair.episodes else []


def _failures(experiment: Experiment, found: Sequence[tuple[Cell, Pooled]]) -> list[str]:
    """Counts how rollouts failed, in cells where that is judged."""
    lines = []
    for cell, pooled in found:
        trials = [trial for result in pooled.results for trial in result.trials]
        kinds = Counter(trial.failure for trial in trials if trial.failure)
        if not cell.recipe.judged or not any(result.labels for result in pooled.results):
            continue
        published = experiment.failures.get(cell.row, {}) if cell.method == experiment.reference else {}
        for kind in (WRONG_SKILL, MANIPULATION):
            count, name = kinds[kind], kind.replace("_", " ")
            ours = f"{100 * count / len(trials):.1f} ({count} of {len(trials)})"
            lines.append(f"| {cell.row} | {cell.method} | {name} | {published_text(published.get(kind))} | {ours} |")
    if not lines:
        return []
    return ["| row | method | failed by | paper, % of trials | ours, % of trials |", "|---" * 5 + "|", *lines, ""]


def not_run(experiment: Experiment, sizes: Sequence[Size], results: Results) -> str:
    """Lists what there is no result of, with the command that would make it, and what the paper has for it."""
    lines = []
    if not results and not experiment.is_ours:
        lines.append(f"Published: {_named([cell for cell in experiment.cells if cell.published])}.\n")
    for size in sizes:
        absent = [cell for cell in experiment.cells if (size.name, cell.row, cell.method) not in results]
        if absent:
            command = f"`python scripts/reproduce.py --experiments='[{experiment.name}]' --size={size.name}`"
            cells = "" if len(absent) == len(experiment.cells) else f" {_named(absent)};"
            lines.append(f"Not run, {size.title}:{cells} {command}\n")
    return "\n".join(lines)


def _named(cells: Sequence[Cell]) -> str:
    return "; ".join(
        f"{c.row}, {c.method}" + (f" ({published_text(c.published)})" if c.published else "") for c in cells
    )


def demo_table(stages: Sequence[Mapping[str, Any]]) -> str:
    """Writes what ``make demo`` prints.

    Args:
        stages: ``stage``, ``seconds`` and ``figure`` of each.
    """
    lines = [f"{stage['stage']:<10}{stage['seconds']:>8}  {stage['figure']}" for stage in stages]
    total = sum(stage["seconds"] for stage in stages)
    return "\n".join([f"{'stage':<10}{'seconds':>8}  figure", *lines, f"{'total':<10}{total:>8}"])
