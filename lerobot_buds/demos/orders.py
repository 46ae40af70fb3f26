"""The order in which a demonstrator does the stages: drawn anew for every episode where the task leaves a choice."""

import numpy as np

from lerobot_buds.envs import Task


def draw_order(task: Task, rng: np.random.Generator) -> list[int]:
    """Draws a valid order of a task's stages.

    Args:
        task: The task.
        rng: Source of the choices; untouched where there is none.

    Returns:
        Indices into ``task.stages``, each once: at every point any stage whose needs are met is equally likely.
    """
    order: list[int] = []
    while len(order) < len(task.stages):
        ready = task.possible_stages(order)
        order.append(ready[0] if len(ready) == 1 else int(rng.choice(ready)))
    return order
