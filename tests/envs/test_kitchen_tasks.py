"""The starts and goals of the kitchen and of the nine multitask variants, on states made by hand. Nothing is drawn."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

from lerobot_buds.envs import TASKS, tasks_named
from lerobot_buds.envs.loading import open_simulation

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from lerobot_buds.envs.simulation.tabletop import TabletopEnv

MULTITASK = [task.name for task in tasks_named("multitask_kitchen")]
SETTLE = np.array([0.0, 0.0, 0.0, -1.0])

# Variant -> facts that hold at its start, after the original's table.
STARTS = {
    "task1_variant1": {"stove_on"},
    "task1_variant2": {"drawer_closed", "stove_on"},
    "task1_variant3": {"drawer_closed", "stove_off"},
    "task2_variant1": {"drawer_closed", "stove_off"},
    "task2_variant2": {"drawer_closed", "stove_on"},
    "task2_variant3": {"stove_on"},
    "task3_variant1": {"stove_off", "cube_in_pot", "cube_touches_pot"},
    "task3_variant2": {"drawer_closed", "stove_off"},
    "task3_variant3": {"stove_off"},
}


@pytest.fixture(scope="module")
def opened() -> Iterator[Callable[[str], "TabletopEnv"]]:
    """Opens the simulation of a task, once."""
    simulations: dict[str, TabletopEnv] = {}

    def opened(name: str) -> "TabletopEnv":
        if name not in simulations:
            simulations[name] = open_simulation(TASKS[name])
        return simulations[name]

    yield opened
    for simulation in simulations.values():
        simulation.close()


def start(simulation: "TabletopEnv", seed: int = 0) -> None:
    simulation.reset_with(np.random.default_rng(seed))
    for _ in range(5):
        simulation.step(SETTLE)


def arrange(simulation: "TabletopEnv", pot: tuple[float, float, float], lever: float, cube_in_pot: bool = True) -> None:
    """Puts the pot somewhere, the cube 0.5 mm deep into its floor or far from it, and the lever at an angle."""
    state = simulation.state
    floor, away = np.add(pot, (0.0, 0.0, 0.027)), np.array([-0.3, 0.0, 0.92])
    state.set_pose("pot", np.array(pot), 0.0)
    state.set_pose("cube", floor if cube_in_pot else away, 0.0)
    state.set_joint("button_hinge", lever)
    simulation.sim.forward()


def test_all_variants_are_selected_by_the_name_of_the_suite_in_the_order_of_the_paper() -> None:
    assert [f"multitask_kitchen/{name}" for name in STARTS] == MULTITASK


def test_variants_share_their_tasks_goal_and_description_and_tasks_do_not() -> None:
    by_task = [MULTITASK[i : i + 3] for i in (0, 3, 6)]
    for names in by_task:
        assert len({(TASKS[name].description, TASKS[name].goal) for name in names}) == 1
    assert len({TASKS[names[0]].description for names in by_task}) == 3
    assert len({TASKS[names[0]].goal for names in by_task}) == 3


@pytest.mark.parametrize("name", [*STARTS])
def test_a_variant_starts_as_in_the_table_and_is_no_success(opened: Callable[..., "TabletopEnv"], name: str) -> None:
    simulation = opened(f"multitask_kitchen/{name}")
    for seed in range(3):
        start(simulation, seed)
        assert {fact for fact, holds in simulation.facts().items() if holds} == STARTS[name]
        assert not simulation.succeeded()
        slide = 0.0 if "drawer_closed" in STARTS[name] else -0.10
        assert simulation.state.joint("cabinet_slide") == pytest.approx(slide, abs=0.005)


def test_a_seed_means_the_same_pot_in_every_variant(opened: Callable[..., "TabletopEnv"]) -> None:
    places = []
    for name in MULTITASK:
        simulation = opened(name)
        simulation.reset_with(np.random.default_rng(3))
        places.append(simulation.state.position("pot_main"))
    assert np.ptp(places, axis=0).max() == 0.0


@pytest.mark.parametrize(
    ("number", "pot", "lever", "spoiled"),
    [
        (1, (0.05, 0.20, 0.92), 0.1, {"lever": -0.01}),
        (1, (0.05, 0.20, 0.92), 0.1, {"pot": (0.14, 0.0, 0.9025)}),
        (1, (0.05, 0.20, 0.92), 0.1, {"cube_in_pot": False}),
        (2, (0.14, 0.0, 0.9025), 0.1, {"lever": -0.01}),
        (2, (0.14, 0.0, 0.9025), 0.1, {"pot": (0.05, 0.20, 0.92)}),
        (2, (0.14, 0.0, 0.9025), 0.1, {"cube_in_pot": False}),
        (3, (0.14, 0.0, 0.9025), -0.1, {"lever": 0.01}),
        (3, (0.14, 0.0, 0.9025), -0.1, {"pot": (0.05, 0.20, 0.92)}),
        (3, (0.14, 0.0, 0.9025), -0.1, {"cube_in_pot": False}),
    ],
)
def test_a_multitask_goal_needs_every_fact(
    opened: Callable[..., "TabletopEnv"], number: int, pot: tuple[float, float, float], lever: float, spoiled: dict
) -> None:
    simulation = opened(f"multitask_kitchen/task{number}_variant2")
    simulation.reset_with(np.random.default_rng(0))
    arrange(simulation, pot, lever)
    assert simulation.succeeded()
    simulation.state.set_joint("cabinet_slide", -0.011)
    simulation.sim.forward()
    assert not simulation.succeeded()
    simulation.state.set_joint("cabinet_slide", -0.009)
    arrange(simulation, **({"pot": pot, "lever": lever} | spoiled))
    assert not simulation.succeeded()


@pytest.fixture
def kitchen(opened: Callable[..., "TabletopEnv"]) -> "TabletopEnv":
    simulation = opened("kitchen/full")
    start(simulation)
    return simulation


def switch_on_and_off(simulation: "TabletopEnv") -> None:
    for angle in (0.1, -0.1):
        simulation.state.set_joint("button_hinge", angle)
        simulation.step(SETTLE)


def test_the_kitchen_starts_with_everything_to_do(kitchen: "TabletopEnv") -> None:
    for seed in range(3):
        start(kitchen, seed)
        assert {fact for fact, holds in kitchen.facts().items() if holds} == {"stove_off", "pot_on_table"}
        assert not kitchen.succeeded()


@pytest.mark.parametrize(
    ("offset", "inside"),
    [
        ((0.049, 0.0, 0.02), True),
        ((0.051, 0.0, 0.02), False),
        ((-0.051, 0.0, 0.02), False),
        ((0.0, 0.099, 0.02), True),
        ((0.0, 0.101, 0.02), False),
        ((0.0, -0.101, 0.02), False),
        ((0.0, 0.0, 0.049), True),
        ((0.0, 0.0, 0.051), False),
    ],
)
def test_the_kitchen_is_done_only_in_the_serving_region(
    kitchen: "TabletopEnv", offset: tuple[float, float, float], inside: bool
) -> None:
    switch_on_and_off(kitchen)
    arrange(kitchen, tuple(np.array([0.145, -0.15, 0.878]) + offset), lever=-0.1)
    assert kitchen.succeeded() is inside


def test_the_kitchen_is_not_done_with_the_stove_on_or_the_cube_outside(kitchen: "TabletopEnv") -> None:
    switch_on_and_off(kitchen)
    served = (0.145, -0.15, 0.9025)
    arrange(kitchen, served, lever=-0.01)
    assert kitchen.succeeded()
    arrange(kitchen, served, lever=0.01)
    assert not kitchen.succeeded()
    arrange(kitchen, served, lever=-0.01, cube_in_pot=False)
    assert not kitchen.succeeded()


def test_the_stove_must_have_been_on_in_this_episode(kitchen: "TabletopEnv") -> None:
    served = (0.145, -0.15, 0.9025)
    arrange(kitchen, served, lever=-0.1)
    assert not kitchen.succeeded()
    switch_on_and_off(kitchen)
    arrange(kitchen, served, lever=-0.1)
    assert kitchen.facts()["stove_has_been_on"] and kitchen.succeeded()
    start(kitchen)
    assert not kitchen.facts()["stove_has_been_on"]
    arrange(kitchen, served, lever=-0.1)
    assert not kitchen.succeeded()


def test_a_pot_on_the_burning_stove_does_not_hide_the_flame(kitchen: "TabletopEnv") -> None:
    model = kitchen.sim.model
    pot_half_width, stove_half_width = 0.067, 0.095
    assert pot_half_width + 0.01 < model.geom_size[model.geom_name2id("stove_flame_visual")][0] < stove_half_width
