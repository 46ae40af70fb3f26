"""How much CPU a command takes to say what it can do."""

import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from .figures import Figure, Setting

COMMANDS = ("segment", "compare", "report", "collect", "diagnose", "rollout")


def measure(setting: Setting) -> Iterator[Figure]:
    """Asks commands for their options."""
    for name in COMMANDS[: 1 if setting.size.repeats == 1 else None]:
        program = Path(sys.executable).with_name(f"lerobot-buds-{name}")
        before = _seconds()
        subprocess.run([program, "--help"], check=True, stdout=subprocess.DEVNULL)
        yield Figure(f"lerobot-buds-{name} --help", _seconds() - before, "s of CPU")


def _seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
