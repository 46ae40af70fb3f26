"""Times what users wait for, each beside what it is compared with; prints ratios, draws growth, writes JSON.

    python scripts/benchmark.py                                   # everything, some half an hour on two cores
    python scripts/benchmark.py --parts='[training, acting]' --device=cuda --batch_size=128
    python scripts/benchmark.py --size=tiny                       # that all of it runs

Quote ratios within one run: machines of the same kind differ from day to day.
"""

import importlib
import os
import platform
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import torch
from benchmarks.figures import SIZES, Figure, Setting

from lerobot_buds.cli.running import parse
from lerobot_buds.core import ConfigError, near_names, write_json

PARTS = (
    "commands",
    "recording",
    "rendering",
    "loading",
    "representation",
    "discovery",
    "training",
    "acting",
    "growth",
    "scale",
)


@dataclass
class BenchmarkConfig:
    """What is timed, and where."""

    parts: list[str] = field(default_factory=lambda: list(PARTS))
    """Which of the parts; each is a module of ``scripts/benchmarks``."""

    size: str = "usual"
    """``usual``, the paper's networks and images, or ``tiny``, which says nothing of speed."""

    output: Path = Path("outputs/benchmark")
    """Folder for ``benchmark.json``, its tables and the plots."""

    device: str = "cpu"
    """Where networks run."""

    batch_size: int | None = None
    """Frames of a step of training; None for the size's own."""

    threads: int = 2
    """Threads of PyTorch."""

    demonstrations: list[int] = field(default_factory=list)
    """Numbers of demonstrations for the part ``scale``; those of the size where none is given."""

    only: str = ""
    """Part of the name of the trainings and policies that are timed alone."""


def measured(config: BenchmarkConfig) -> dict[str, list[Figure]]:
    """Runs the parts and prints every figure as soon as it is there.

    Raises:
        ConfigError: There is no such size or part.
    """
    for name, known in (("size", SIZES), ("part", PARTS)):
        for wanted in [config.size] if name == "size" else config.parts:
            if wanted not in known:
                raise ConfigError(f"There is no {name} {wanted!r}. {near_names(wanted, known)}")
    size = SIZES[config.size]
    if config.demonstrations:
        size = replace(size, demonstrations=tuple(config.demonstrations))
    torch.set_num_threads(config.threads)
    results: dict[str, list[Figure]] = {}
    for part in config.parts:
        figures = results[part] = []
        with TemporaryDirectory(prefix="buds-benchmark-") as place:
            setting = Setting(size, config.batch_size or size.batch, config.device, config.only, Path(place))
            print(f"{part}:", flush=True)
            for figure in importlib.import_module(f"benchmarks.{part}").measure(setting):
                figures.append(figure)
                print(in_words(figure, figures), flush=True)
                write_json(config.output / "benchmark.json", described(config, results))
    return results


def in_words(figure: Figure, figures: list[Figure]) -> str:
    """Writes a figure as a line, with how it compares."""
    name = figure.what if figure.at is None else f"{figure.what}, {figure.at}"
    line = f"  {name:<48} {number(figure.value):>10} {figure.unit}"
    other = compared(figure, figures)
    return line if other is None else f"{line}, {figure.times(other):.2f} times {other.what}"


def number(value: float) -> str:
    """Writes a value with three digits, or all before the point."""
    return f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"


def compared(figure: Figure, figures: list[Figure]) -> Figure | None:
    """Finds what a figure is compared with, unless it was not asked for."""
    return next((other for other in figures if other.what == figure.against), None)


def in_table(results: dict[str, list[Figure]]) -> str:
    """Writes what has no place on an axis as tables in Markdown, one a part."""
    lines = []
    for part, figures in results.items():
        rows = [figure for figure in figures if figure.at is None]
        if not rows:
            continue
        lines += [f"| {part} | figure | against |", "|---|---|---|"]
        for figure in rows:
            other = compared(figure, figures)
            against = "" if other is None else f"{figure.times(other):.2f} times {other.what}"
            lines.append(f"| {figure.what} | {number(figure.value)} {figure.unit} | {against} |")
        lines.append("")
    return "\n".join(lines)


def described(config: BenchmarkConfig, results: dict[str, list[Figure]]) -> dict[str, Any]:
    """Puts the figures beside what they were measured on."""
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else None
    return {
        "config": {**asdict(config), "output": str(config.output)},
        "machine": {"cores": os.cpu_count(), "processor": platform.machine(), "gpu": gpu, "load": os.getloadavg()[0]},
        "versions": {
            name: version(name) for name in ("lerobot_policy_buds", "lerobot", "torch", "robosuite", "mujoco")
        },
        "figures": {
            part: [
                {**asdict(f), "times": None if (other := compared(f, figures)) is None else f.times(other)}
                for f in figures
            ]
            for part, figures in results.items()
        },
    }


def draw(figures: list[Figure], path: Path, axis: str) -> None:
    """Draws what has a place on an axis, one panel a unit."""
    from matplotlib.figure import Figure as Picture

    units = list(dict.fromkeys(figure.unit for figure in figures if figure.at is not None))
    picture = Picture(figsize=(5 * len(units), 3.5), layout="constrained")
    for panel, unit in zip(picture.subplots(1, len(units), squeeze=False)[0], units, strict=True):
        for what in dict.fromkeys(f.what for f in figures if f.unit == unit and f.at is not None):
            points = [(f.at, f.value) for f in figures if f.what == what and f.unit == unit]
            panel.plot(*zip(*points, strict=True), marker="o", label=what)
        panel.set(xlabel=axis, ylabel=unit, ylim=(0, None), xticks=sorted({f.at for f in figures if f.at is not None}))
        panel.legend(fontsize="x-small")
    picture.savefig(path, dpi=120)


def main() -> None:
    """Measures, writes and draws."""
    config = parse(BenchmarkConfig)
    config.output.mkdir(parents=True, exist_ok=True)
    results = measured(config)
    for part, axis in (("growth", "skills"), ("scale", "demonstrations")):
        if part in results:
            draw(results[part], config.output / f"{part}.png", axis)
    (config.output / "benchmark.md").write_text(in_table(results), encoding="utf-8")
    print(f"All of it is in {config.output}.")


if __name__ == "__main__":
    main()
