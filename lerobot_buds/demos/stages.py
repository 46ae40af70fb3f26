"""Every stage that a demonstrator can do, by the name that tasks list it under."""

from . import drawer, kitchen
from .vocabulary import Stage

STAGES: dict[str, Stage] = {**drawer.STAGES, **kitchen.STAGES}
"""Stage name -> how it is done. A name means the same motion in every task."""
