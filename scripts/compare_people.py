"""Compares how people and our demonstrators move, for docs/human.md: speeds, pauses, corrections, misses.

People's demonstrations are those of scripts/human_demonstrations.py, taken at 20 Hz, of which nothing is drawn here.
Ours are attempts in both manners from seed 0 on, until enough succeed; those are measured. Results are kept in a JSON
file after every row; an interrupted run goes on with what is missing.

    python scripts/compare_people.py --episodes=10
"""

from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import draccus
import numpy as np
from human_demonstrations import RECORDINGS, fetch, open_command, source_of

from lerobot_buds.core import ACTION, STATE, IntArray, read_json, write_json
from lerobot_buds.demos.attempts import MANNERS, Style, attempt
from lerobot_buds.demos.hdf5 import open_demonstrations
from lerobot_buds.demos.movement import Movement, Vec, measure, table
from lerobot_buds.envs import FPS, EnvSettings, RobosuiteEnv, tasks_named


@dataclass
class CompareConfig:
    """What to compare."""

    task: str = "tool_use/full,hammer_place/full,kitchen/full"
    """Our tasks, comma-separated."""

    episodes: int = 10
    """Successful demonstrations of each task in each manner."""

    human: Path = Path("outputs/human")
    """Where people's demonstrations are kept, as scripts/human_demonstrations.py does."""

    output: Path = Path("outputs/people.json")
    """Where the results are kept."""


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        episodes: Number of episodes measured.
        movement: How the hand moved in them.
        attempts: Attempts behind them; people's are not known.
        failures: Failed attempts by stage and reason.
        retries: What was missed and done again, by stage.
    """

    episodes: int
    movement: Movement
    attempts: int = 0
    failures: dict[str, int] | None = None
    retries: dict[str, int] | None = None


def people(name: str, cache: Path) -> Row:
    """Measures people's demonstrations of one recording."""
    recording = RECORDINGS[name]
    source = replace(source_of(recording, fetch(recording.version, cache / "wheels")), cameras={})
    with open_demonstrations(source) as demonstrations:
        read = [demonstrations.read(one) for one in demonstrations.lengths]
    episodes = [movement_of(columns[STATE], columns[ACTION], open_command(name)) for columns in read]
    return Row(len(episodes), measure(episodes, FPS))


def ours(task: str, manner: str, wanted: int) -> Row:
    """Measures our demonstrations of a task; two attempts for every one that is wanted may fail."""
    env = RobosuiteEnv(EnvSettings(task, None, image_size=16, draws=False))
    done, failures, retries, seed = [], Counter[str](), Counter[str](), 0
    while len(done) < wanted and seed < 3 * wanted:
        result = attempt(env, seed, style=Style(manner))
        seed += 1
        if result.success:
            done.append(movement_of(result.arrays["agent_pos"], result.arrays["action"], 0.0))
            retries.update(result.retries)
        else:
            failures[result.failure] += 1
    env.close()
    return Row(len(done), measure(done, FPS), seed, dict(failures), dict(retries))


def movement_of(state: np.ndarray, action: np.ndarray, threshold: float) -> tuple[Vec, IntArray]:
    """Takes the hand's path (m) and whether the gripper is told to be closed out of an episode's columns."""
    return state[:, -3:].astype(np.float64), (action[:, -1] > threshold).astype(np.int64)


def main() -> None:
    """Measures what the output lacks, then prints the table, and attempts, failures and retries of ours."""
    config = draccus.parse(CompareConfig)
    known = read_json(config.output) if config.output.exists() else {}
    work = {name: lambda name=name: people(name, config.human.absolute()) for name in RECORDINGS}
    for task in tasks_named(config.task):
        for manner in MANNERS:
            work[f"{task.name}, {manner}"] = lambda task=task, manner=manner: ours(task.name, manner, config.episodes)
    for name, do in work.items():
        if name not in known:
            known[name] = asdict(do())
            write_json(config.output, known)
    print(table({name: (known[name]["episodes"], Movement(**known[name]["movement"])) for name in work}))
    for name, row in known.items():
        if row["attempts"]:
            print(f"{name}: {row['episodes']} of {row['attempts']} attempts, retries {row['retries']}", row["failures"])


if __name__ == "__main__":
    main()
