"""Experiments as data: what a table of the paper compares, and at which size it is run.

An experiment is a file of ``configs/experiments``: its table of rows and methods, each with what sets it apart, and the
published figures. A size is a file of ``configs/experiments/sizes``.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import draccus
import yaml
from draccus.utils import ParsingError

from lerobot_buds.core import ConfigError
from lerobot_buds.envs import tasks_named

_NEEDED = {"title", "reference", "rows", "methods"}
_OPTIONAL = {"about", "short", "recipe", "published", "failures"}
"""What an experiment's file holds."""


@dataclass(frozen=True)
class Recipe:
    """How one cell of a table comes about; tasks are named as in `tasks_named`.

    Attributes:
        demonstrations: Tasks that are demonstrated, all in one dataset.
        episodes: Demonstrations of each.
        manner: How they are demonstrated, as for ``lerobot-buds-collect``.
        representation: Settings of the representation (``--representation.*``) beside those of the size.
        segmented: Those of the tasks whose demonstrations are segmented; empty for all.
        discovery: Settings file of skill discovery.
        labels_from: Where skills come from instead of being discovered, as for ``lerobot-buds-segment``.
        segmentation: Further settings of skill discovery (``--discovery.*``).
        library: Tasks on whose demonstrations a library of skills is trained first; empty for none.
        trained: Tasks on whose demonstrations the policy is trained, with a library its meta controllers alone; empty
            for all that are segmented.
        policy: Settings of the policy (``--policy.*``) beside those of the size.
        evaluated: Tasks in which it is evaluated, the trials shared out among them.
        trials: Trials of one training in the paper.
        slowness: How many times as long as usual demonstrations take; the size's limits on episodes grow with it.
        judged: Failures are classified, for which the segmented demonstrations are asked at every decision.
    """

    demonstrations: str = ""
    episodes: int = 100
    manner: str = "scripted"
    representation: dict[str, Any] = field(default_factory=dict)
    segmented: str = ""
    discovery: str = ""
    labels_from: str = ""
    segmentation: dict[str, Any] = field(default_factory=dict)
    library: str = ""
    trained: str = ""
    policy: dict[str, Any] = field(default_factory=dict)
    evaluated: str = ""
    trials: int = 100
    slowness: float = 1.0
    judged: bool = False


@dataclass(frozen=True)
class Size:
    """How large everything is.

    Attributes:
        name: Its name.
        title: What the report calls it.
        image_size: Height and width of both cameras (pixels).
        render_profile: What is drawn, as for ``lerobot-buds-collect``.
        video: Stores the cameras as video.
        segment: Settings file of ``lerobot-buds-segment``.
        policy: Settings file of the policy.
        representation: Settings of the representation beside those of the file.
        policy_settings: Settings of the policy beside those of the file.
        in_memory: Trains by ``scripts/train_in_memory.py``, else by ``lerobot-train``.
        steps: Training steps of a policy with a meta controller.
        flat_steps: Those of a flat policy, as many as take the same time.
        batch_size: Frames a step.
        at_once: Episodes that run side by side, in a process each; on a GPU outcomes depend on it, by rounding.
        episode_length: Most control steps of an episode, by task; else the task's own.
        most_episodes: Most demonstrations of a task; None for as many as the experiment says.
        most_trials: Most trials of one training.
        seeds: Seeds of the trainings that are run where none are asked for.
        reported: Its figures mean something: they belong into the report.
    """

    name: str
    title: str
    image_size: int
    render_profile: str
    segment: str
    policy: str
    steps: int
    flat_steps: int
    batch_size: int
    video: bool = False
    representation: dict[str, Any] = field(default_factory=dict)
    policy_settings: dict[str, Any] = field(default_factory=dict)
    in_memory: bool = False
    at_once: int = 1
    episode_length: dict[str, int] = field(default_factory=dict)
    most_episodes: int | None = None
    most_trials: int | None = None
    seeds: list[int] = field(default_factory=lambda: [1000])
    reported: bool = True

    @classmethod
    def read(cls, path: Path) -> "Size":
        """Reads a size's file.

        Raises:
            ConfigError: It cannot be read, or has settings that are unknown.
        """
        return _decode(cls, {"name": path.stem} | _read(path), path)


@dataclass(frozen=True)
class Cell:
    """One figure of a table.

    Attributes:
        experiment: Name of the experiment.
        row: Name of the row.
        method: Name of the column.
        recipe: How it comes about.
        published: Mean and spread of the paper's success rate (%), or None; the spread is None where none is told.
    """

    experiment: str
    row: str
    method: str
    recipe: Recipe
    published: tuple[float, float | None] | None = None

    @property
    def name(self) -> str:
        """A name for files: row and method."""
        return ".".join("".join(c if c.isalnum() else "_" for c in part.lower()) for part in (self.row, self.method))


@dataclass(frozen=True)
class Experiment:
    """One table.

    Attributes:
        name: Its name, that of its file.
        title: Heading.
        about: What it compares, in Markdown.
        rows: Names of the rows.
        methods: Names of the columns.
        cells: Its figures, row by row.
        reference: Method that the others are compared with on the same episodes.
        short: What README calls its rows, before the row's name.
        failures: Row -> class of failure -> mean and spread of its share of the paper's trials (%).
    """

    name: str
    title: str
    about: str
    rows: tuple[str, ...]
    methods: tuple[str, ...]
    cells: tuple[Cell, ...]
    reference: str
    short: str = ""
    failures: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> "Experiment":
        """Reads an experiment's file.

        Raises:
            ConfigError: It cannot be read, or has settings that are unknown.
        """
        content = _read(path)
        unknown = set(content) - _NEEDED - _OPTIONAL
        if absent := _NEEDED - set(content):
            raise ConfigError(f"{path}: there is no {sorted(absent)}.")
        if unknown:
            raise ConfigError(f"{path}: {sorted(unknown)} are unknown.")
        if content["reference"] not in content["methods"]:
            raise ConfigError(f"{path}: reference={content['reference']!r} is none of its methods.")
        common, published = content.get("recipe", {}), content.get("published", {})
        cells = tuple(
            _cell(path, (row, method), [common, row_recipe, method_recipe], published.get(row, {}).get(method))
            for row, row_recipe in content["rows"].items()
            for method, method_recipe in content["methods"].items()
            if method not in row_recipe.get("without", [])
        )
        rows, methods = (tuple(str(name) for name in content[kind]) for kind in ("rows", "methods"))
        return cls(
            name=path.stem,
            title=content["title"],
            about=content.get("about", ""),
            rows=rows,
            methods=methods,
            cells=cells,
            reference=content["reference"],
            short=content.get("short", ""),
            failures=content.get("failures", {}),
        )

    @property
    def is_ours(self) -> bool:
        """Whether the paper has no figure of it."""
        return all(cell.published is None for cell in self.cells)


def _cell(path: Path, names: tuple[Any, Any], parts: list[Mapping[str, Any]], published: Any) -> Cell:
    """Puts a recipe together: what table, row and method say, the later before the earlier."""
    merged: dict[str, Any] = {}
    for part in parts:
        for key, value in part.items():
            merged[key] = merged.get(key, {}) | value if isinstance(value, Mapping) else value
    merged.pop("without", None)
    numbers = {"number": merged.pop("number", "")}
    merged = {key: value.format(**numbers) if isinstance(value, str) else value for key, value in merged.items()}
    recipe = _decode(Recipe, merged, path)
    for names_of_tasks in (recipe.demonstrations, recipe.evaluated):
        tasks_named(names_of_tasks)
    return Cell(path.stem, str(names[0]), str(names[1]), recipe, _figures(published))


def _figures(published: Any) -> tuple[float, float | None] | None:
    if isinstance(published, list):
        mean, spread = published
        return float(mean), float(spread)
    return None if published is None else (float(published), None)


def _read(path: Path) -> dict[str, Any]:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError(f"{path} cannot be read ({error}).") from error
    if not isinstance(content, dict):
        raise ConfigError(f"{path} holds no settings.")
    return content


def _decode[T](cls: type[T], content: Mapping[str, Any], path: Path) -> T:
    unknown = set(content) - {f.name for f in fields(cls)}  # type: ignore[arg-type]
    if unknown:
        raise ConfigError(f"{path}: {sorted(unknown)} are unknown; known are {[f.name for f in fields(cls)]}.")  # type: ignore[arg-type]
    try:
        decoded: T = draccus.decode(cls, dict(content))
    except (ParsingError, TypeError) as error:
        raise ConfigError(f"{path}: {error}") from error
    return decoded
