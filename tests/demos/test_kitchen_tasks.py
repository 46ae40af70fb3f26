"""The kitchens' demonstrators do their tasks, in an order that the task allows. Nothing is drawn here."""

from collections import Counter
from itertools import permutations

import numpy as np
import pytest

from lerobot_buds.demos.attempts import attempt
from lerobot_buds.demos.orders import draw_order
from lerobot_buds.envs import TASKS, EnvSettings, RobosuiteEnv, Task, tasks_named

pytestmark = pytest.mark.slow

KITCHENS = [task.name for task in tasks_named("kitchen,multitask_kitchen,real_kitchen")]


def task_of(stages: tuple[str, ...], needs: dict[str, tuple[str, ...]]) -> Task:
    return Task("test/task", "do", "kitchen", frozenset(), (), (), stages, needs=needs)


@pytest.mark.parametrize("name", KITCHENS)
def test_the_demonstrator_does_every_stage_once_and_succeeds(name: str) -> None:
    env, task = RobosuiteEnv(EnvSettings(name, draws=False)), TASKS[name]
    result = attempt(env, 0)
    env.close()
    assert result.success, result.failure
    stage = result.arrays["true_stage"][:, 0]
    order = stage[np.append(True, np.diff(stage) != 0)].tolist()
    assert sorted(order) == list(range(len(task.stages)))
    assert len(stage) < task.max_steps / 2


def test_without_freedom_the_order_is_the_tasks_own_and_costs_no_random_number() -> None:
    task, rng = task_of(("a", "b", "c"), {}), np.random.default_rng(0)
    assert draw_order(task, rng) == [0, 1, 2]
    assert rng.bit_generator.state == np.random.default_rng(0).bit_generator.state


@pytest.mark.parametrize(
    ("needs", "expected"),
    [
        ({"a": (), "b": (), "c": ()}, set(permutations(range(3)))),
        ({"b": (), "c": ("b",)}, {(0, 1, 2), (1, 0, 2), (1, 2, 0)}),
        ({"b": ()}, {(0, 1, 2), (1, 0, 2)}),
    ],
)
def test_every_valid_order_is_drawn_and_no_other(
    needs: dict[str, tuple[str, ...]], expected: set[tuple[int, ...]]
) -> None:
    task, rng = task_of(("a", "b", "c"), needs), np.random.default_rng(1)
    drawn = Counter(tuple(draw_order(task, rng)) for _ in range(300))
    assert set(drawn) == expected
    assert min(drawn.values()) > 20


@pytest.mark.parametrize("name", KITCHENS)
def test_a_tasks_needs_name_its_stages_and_leave_an_order(name: str) -> None:
    task = TASKS[name]
    for needed in task.needs.values():
        assert set(needed) <= set(task.stages)
    rng = np.random.default_rng(0)
    for _ in range(20):
        assert sorted(draw_order(task, rng)) == list(range(len(task.stages)))


def test_the_kitchen_is_cooked_before_it_is_served() -> None:
    task, rng = TASKS["kitchen/full"], np.random.default_rng(0)
    for _ in range(100):
        order = [task.stages[number] for number in draw_order(task, rng)]
        served = order.index("pot_off_stove")
        assert max(order.index(stage) for stage in ("turn_on", "pot_on_stove", "cube_in_pot")) < served
        assert served < order.index("push_pot")
        assert order.index("turn_on") < order.index("turn_off")
