"""The paper's experiments: as data, as stages that run public commands, and as a report of what they came to."""

from .experiment import Cell, Experiment, Recipe, Size
from .report import write_report
from .reproduction import Reproduction
from .results import CellResult, Paired, Pooled, Trial, collect_result, paired, result_path
from .running import StageError, Workplace, local_launcher, run_stages, stop_commands, submitit_launcher
from .stages import Run, Stage, plan
from .tables import demo_table

__all__ = [
    "Cell",
    "CellResult",
    "Experiment",
    "Paired",
    "Pooled",
    "Recipe",
    "Reproduction",
    "Run",
    "Size",
    "Stage",
    "StageError",
    "Trial",
    "Workplace",
    "collect_result",
    "demo_table",
    "local_launcher",
    "paired",
    "plan",
    "result_path",
    "run_stages",
    "stop_commands",
    "submitit_launcher",
    "write_report",
]
