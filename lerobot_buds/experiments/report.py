"""Makes docs/results.md, its pictures and README's table from the results."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from lerobot_buds.core import read_json, write_atomically

from .experiment import Experiment, Size
from .pictures import draw_experiment
from .results import CellResult, Pooled
from .tables import Results, demo_table, not_run, size_section

HEADER = """\
# Results

Made from `docs/results/` by `python scripts/reproduce.py --report_only=true`: not edited by hand. How to run all of it:
[reproduce.md](reproduce.md).

**The paper's figures and ours do not compare one to one.** Our demonstrations are scripted, the paper's are a person's
with a SpaceMouse; physics and rendering are those of another robosuite; and the size `cpu` is smaller in images and
networks. What can be compared is the order of methods within a table.

"Ours" is the mean over the trainings, with their standard deviation where there are several; behind it the successes of
all trials, with a 95 % Wilson interval. Every result's file has the outcome and seed of each trial, steps, wall time,
commit, versions, and hashes of data and labels. Demonstrations and tuning use seeds below 100,000, evaluations 500,000
and up, the same for all methods; with several tasks in a cell every task starts at 500,000.

Elsewhere: what was tried on the policy ([ablations.md](ablations.md)), how fast everything is
([performance.md](performance.md)), how segmentations compare ([segmentation.md](segmentation.md)).
"""


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
    parts = [HEADER]
    for experiment in experiments:
        found = load_results(results, experiment)
        parts.append(f"## {experiment.title}\n\n{experiment.about}\n")
        if found:
            parts.append(f"![{experiment.title}: the paper's figures beside ours](results/{experiment.name}.png)\n")
        parts += [size_section(experiment, size, found) for size in sizes]
        parts.append(not_run(experiment, sizes, found))
    return "\n".join(part for part in parts if part)


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
    """Puts the headline figures, and what the demo came to, between the marks of README."""
    lines = ["| task | flat behaviour cloning | `buds` | size | training seeds |", "|---|---|---|---|---|"]
    for experiment in experiments:
        found = load_results(results, experiment)
        for size in sizes:
            lines += [line for row in experiment.rows for line in _headlines(experiment, row, found, size)]
    text = _between(text, "results", "\n".join(lines))
    demo = results / "demo.json"
    return _between(text, "demo", f"```\n{demo_table(read_json(demo))}\n```") if demo.exists() else text


def _between(text: str, mark: str, content: str) -> str:
    pattern = rf"(<!-- {mark} -->\n).*?(<!-- /{mark} -->)"
    return re.sub(pattern, lambda m: f"{m[1]}\n{content}\n\n{m[2]}", text, flags=re.DOTALL)


def _headlines(experiment: Experiment, row: str, found: Results, size: Size) -> Iterator[str]:
    """Sets flat policies against what they are to be compared with: the method of their name, else the reference."""
    for flat in (m for m in experiment.methods if m.startswith("BC")):
        ours = flat.replace("BC", experiment.reference)
        ours, variant = (ours, flat.removeprefix("BC")) if ours in experiment.methods else (experiment.reference, "")
        if all((size.name, row, method) in found for method in (flat, ours)):
            a, b = (found[size.name, row, method] for method in (flat, ours))
            rates = [f"{p.rate.successes} of {p.rate.episodes} ({p.rate.low:.0%} to {p.rate.high:.0%})" for p in (a, b)]
            name = f"{experiment.short} {row}{variant}".strip()
            yield f"| {name} | {rates[0]} | {rates[1]} | {size.title} | {', '.join(map(str, b.seeds))} |"
