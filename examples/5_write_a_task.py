"""5. Write a task: another goal on a table that is there, out of facts and motions that are there.

    python examples/5_write_a_task.py --output=outputs/fetch.png

The scene of Tool-Use knows whether the cube is fetched and the tool put aside, and the demonstrator how to do both, so
a task "fetch the cube, and leave it there" is a few lines, and works in the process that has them. Commands are other
processes, and so are their workers: to record it by `lerobot-buds-collect` and to evaluate on it, put the lines into
`lerobot_buds/envs/tasks.py`.

What takes more, inside the package:
  - another table: a class with `objects`, `place` and `facts` in `envs/simulation/`, entered in `scenes.py`;
  - another fact: a line in the scene's `facts`, and in `STAGE_FACTS` where a stage aims at it;
  - another motion: a generator out of `demos/vocabulary.py`, entered in the `STAGES` of its module.
"""

import argparse
from pathlib import Path

from lerobot_buds.demos.attempts import attempt
from lerobot_buds.demos.pictures import draw_attempt
from lerobot_buds.envs import TASKS, EnvSettings, RobosuiteEnv, Task

FETCH = Task(
    name="tool_use/fetch",
    description="fetch the cube with the tool and put the tool aside",
    scene="tool_use",
    start=frozenset(),
    goal=("cube_fetched", "tool_put_aside"),
    released_goal=("cube_fetched", "tool_put_aside"),
    stages=("grasp_tool", "hook_cube", "pull_cube", "put_tool_aside"),
    max_steps=1500,
    workspace=TASKS["tool_use/full"].workspace,
)


def main(arguments: list[str] | None = None) -> int:
    """Lets the demonstrator try the task from a few seeds; returns how often it succeeded."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, required=True, help="picture of the last success, stage by stage")
    parser.add_argument("--attempts", type=int, default=3)
    parser.add_argument("--image_size", type=int, default=128)
    chosen = parser.parse_args(arguments)

    TASKS[FETCH.name] = FETCH
    env, successes = RobosuiteEnv(EnvSettings(FETCH.name, None, chosen.image_size, "fast")), 0
    for seed in range(chosen.attempts):
        done = attempt(env, seed)
        successes += done.success
        print(f"seed {seed}: {len(done.arrays['action'])} steps" if done.success else f"seed {seed}: {done.failure}")
        if done.success:
            draw_attempt(done, FETCH.stages, chosen.output)
    env.close()
    return successes


if __name__ == "__main__":
    main()
