"""Every stage that a demonstrator can do, by the name that tasks list it under."""

from . import drawer, hammer_place, kitchen, real_kitchen, tool_use
from .vocabulary import Stage

STAGES: dict[str, Stage] = {
    **drawer.STAGES,
    **hammer_place.STAGES,
    **kitchen.STAGES,
    **real_kitchen.STAGES,
    **tool_use.STAGES,
}
"""Stage name -> how it is done. A name means the same motion in every task."""
