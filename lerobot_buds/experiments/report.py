"""Makes docs/results.md from the results: the paper's figure beside ours, how sure it is, and what has not been run."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from lerobot_buds.core import read_json, write_atomically

from .experiment import Cell, Experiment, Size
from .pictures import draw_experiment
from .reproduction import Reproduction
from .results import CellResult, Pooled, paired

type Results = Mapping[tuple[str, str, str], Pooled]
"""Name of the size, row and method -> all trainings of that cell."""

HEADER = """\
# Results

Made from `docs/results/` by `python scripts/reproduce.py --report_only=true`: not edited by hand.

{scope}

"Ours" is the mean over the trainings, with their standard deviation where there are several; behind it the successes of all
trials, with a 95 % Wilson interval. Every result's file has the outcome and seed of each trial, steps, wall time, commit,
versions, and hashes of data and labels. Demonstrations and tuning use seeds below 100,000, evaluations 500,000 and up,
the same for all methods; with several tasks in a cell every task starts at 500,000.

Elsewhere: what was tried on the policy ([ablations.md](ablations.md)), how fast everything is
([performance.md](performance.md)), how segmentations compare ([segmentation.md](segmentation.md)).
"""

SCOPE = """\
**The paper's figures and ours do not compare one to one.** Our demonstrations are scripted, the paper's are a person's with a
SpaceMouse; physics and rendering are those of another robosuite; and the size `cpu` is smaller in images and networks. What
can be compared is the order of methods within a table."""


def load_results(folder: Path, experiment: Experiment) -> Results:
    """Reads all results of an experiment.

    Raises:
        DatasetError: One is damaged.
    """
    groups: dict[tuple[str, str, str], list[CellResult]] = {}
    for path in sorted((folder / experiment.name).glob("*/*.json")):
        result = CellResult.read(path)
        groups.setdefault((result.size, result.row, result.method), []).append(result)
    return {key: Pooled(tuple(sorted(group, key=lambda r: r.seed))) for key, group in groups.items()}


def report(experiments: Sequence[Experiment], sizes: Sequence[Size], results: Path) -> str:
    """Writes the whole page, in Markdown."""
    parts = [HEADER.format(scope=SCOPE)]
    for experiment in experiments:
        found = load_results(results, experiment)
        parts.append(f"## {experiment.title}\n\n{experiment.about}\n")
        if found:
            parts.append(f"![{experiment.title}: the paper's figures beside ours](results/{experiment.name}.png)\n")
        parts += [_size_section(experiment, size, found) for size in sizes]
        parts.append(_not_run(experiment, sizes, found))
    return "\n".join(part for part in parts if part)


def _size_section(experiment: Experiment, size: Size, results: Results) -> str:
    cells = [(cell, results[key]) for cell in experiment.cells if (key := (size.name, cell.row, cell.method)) in results]
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
        _published(cell.published),
        f"**{pooled.mean:.1f}**" + ("" if pooled.spread is None else f" ± {pooled.spread:.1f}"),
        f"{rate.successes} of {rate.episodes} ({rate.low:.0%} to {rate.high:.0%})",
        ", ".join(map(str, pooled.seeds)),
        f"{first.steps:,}",
        f"{minutes:.1f}",
        ", ".join(map(str, skills)),
        ", ".join(sorted({result.machine for result in pooled.results})),
    ]
    return f"| {' | '.join(columns)} |"


def _published(figures: tuple[float, float | None] | None) -> str:
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
        same = "as in the paper" if theirs == ours else "not as in the paper"
        figures = ", ".join(f"{method} ({means[method]:.0f})" for method in ours)
        lines.append(f"- {row}, from best to worst: {figures}; {same} ({', '.join(theirs)}).")
    return [*lines, ""] if lines else []


def _pairs(experiment: Experiment, size: Size, results: Results) -> list[str]:
    """Compares the table's reference with the others on the same episodes."""
    lines = []
    for row in experiment.rows:
        reference = experiment.reference
        if (size.name, row, reference) not in results:
            continue
        mine = results[size.name, row, reference]
        for method in experiment.methods:
            other = results.get((size.name, row, method))
            if other is None or method == reference:
                continue
            pair = paired(mine, other)
            if pair.episodes:
                lines.append(
                    f"| {row} | {reference} and {method} | {pair.episodes} | {pair.first_alone} | {pair.second_alone} | "
                    f"{pair.p_value:.2g} |"
                )
    if not lines:
        return []
    head = ["| row | on the same episodes | episodes | first alone | second alone | McNemar's p |", "|---|---|---|---|---|---|"]
    return [*head, *lines, ""]


def _failures(experiment: Experiment, found: Sequence[tuple[Cell, Pooled]]) -> list[str]:
    """Counts how rollouts failed, in cells where that is judged."""
    lines = []
    for cell, pooled in found:
        trials = [trial for result in pooled.results for trial in result.trials]
        kinds = Counter(trial.failure for trial in trials if trial.failure)
        if not cell.recipe.judged or not any(result.labels for result in pooled.results):
            continue
        published = experiment.failures.get(cell.row, {}) if cell.method == experiment.reference else {}
        for kind in ("wrong_skill", "manipulation"):
            paper = _published(tuple(published[kind])) if kind in published else ""  # type: ignore[arg-type]
            share = 100 * kinds[kind] / len(trials)
            name = kind.replace("_", " ")
            lines.append(f"| {cell.row} | {cell.method} | {name} | {paper} | {share:.1f} ({kinds[kind]} of {len(trials)}) |")
    if not lines:
        return []
    return ["| row | method | failed by | paper, % of trials | ours, % of trials |", "|---|---|---|---|---|", *lines, ""]


def _not_run(experiment: Experiment, sizes: Sequence[Size], results: Results) -> str:
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
    return "; ".join(f"{c.row}, {c.method}" + (f" ({_published(c.published)})" if c.published else "") for c in cells)


def write_report(configs: Path, results: Path) -> Path:
    """Writes the page and its pictures, and the figures of README.

    Args:
        configs: Folder of the experiments.
        results: Folder of the results; the page lies beside it, README one further up.

    Returns:
        The page.
    """
    experiments, sizes = read_configs(configs)
    for experiment in experiments:
        found = load_results(results, experiment)
        if found:
            draw_experiment(results / f"{experiment.name}.png", experiment, sizes, found)
    page = results.with_suffix(".md")
    text = report(experiments, sizes, results)
    write_atomically(page, lambda part: part.write_text(text, encoding="utf-8"))
    readme = results.parents[1] / "README.md"
    if readme.exists():
        new = readme_with_results(readme.read_text(encoding="utf-8"), experiments, sizes, results)
        write_atomically(readme, lambda part: part.write_text(new, encoding="utf-8"))
    return page


def read_configs(configs: Path) -> tuple[list[Experiment], list[Size]]:
    """Reads all experiments, the paper's tables first, and the sizes whose figures mean something."""
    experiments = [Experiment.read(file) for file in sorted(configs.glob("*.yaml"))]
    experiments.sort(key=lambda e: (not e.name.startswith("table"), e.is_ours, e.name))
    sizes = [Size.read(file) for file in sorted((configs / "sizes").glob("*.yaml"))]
    return experiments, [size for size in sizes if size.reported]


def readme_with_results(text: str, experiments: Sequence[Experiment], sizes: Sequence[Size], results: Path) -> str:
    """Puts a table of the headline figures between the marks of README."""
    lines = ["| task | flat behaviour cloning | `buds` | trials each, training seeds |", "|---|---|---|---|"]
    for experiment in experiments:
        found = load_results(results, experiment)
        for size in sizes:
            lines += [_headline(experiment, row, found, size) for row in experiment.rows]
    table = "\n".join(line for line in lines if line)
    return re.sub(
        r"(<!-- results -->\n).*?(<!-- /results -->)", lambda m: f"{m[1]}\n{table}\n\n{m[2]}", text, flags=re.DOTALL
    )


def _headline(experiment: Experiment, row: str, found: Results, size: Size) -> str:
    flat = next((m for m in experiment.methods if m.startswith("BC")), None)
    if flat is None or any((size.name, row, m) not in found for m in (flat, experiment.reference)):
        return ""
    a, b = (found[size.name, row, method] for method in (flat, experiment.reference))
    rates = [f"{p.rate.successes} of {p.rate.episodes} ({p.rate.low:.0%} to {p.rate.high:.0%})" for p in (a, b)]
    name = f"{experiment.short} {row}".strip()
    return f"| {name} | {rates[0]} | {rates[1]} | {', '.join(map(str, b.seeds))} |"


def planned_table(reproduction: Reproduction) -> str:
    """Lists what a run would do, with the time that its kind took in the results that are there."""
    known = _known_seconds(reproduction)
    lines = [f"{'':<6}{'seconds':>8}  command\n"]
    left = 0.0
    for stage in reproduction.stages:
        done = reproduction.workplace.is_done(stage)
        seconds = reproduction.workplace.state(stage).get("seconds") if done else known.get(stage.kind)
        left += 0.0 if done or seconds is None else seconds
        command = " ".join(stage.command(reproduction.workplace.root))
        shown = "" if seconds is None else f"{seconds:.0f}"
        lines.append(f"{'done' if done else 'to do':<6}{shown:>8}  {command}\n")
    lines.append(f"Some {left / 60:.0f} min of one job to go, by what such stages took elsewhere.\n")
    return "".join(lines)


def _known_seconds(reproduction: Reproduction) -> dict[str, float]:
    """Mean seconds of every kind of stage, over the results of the same size."""
    seconds: dict[str, list[float]] = {}
    for size in {run.size.name for run in reproduction.runs}:
        for path in reproduction.results.glob(f"*/{size}/*.json"):
            for kind, value in read_json(path)["seconds"].items():
                seconds.setdefault(kind, []).append(value)
    return {kind: sum(values) / len(values) for kind, values in seconds.items()}
