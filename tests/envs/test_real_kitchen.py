"""The goal of the real kitchen's twin, on states made by hand on both sides of every threshold. Nothing is drawn."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

from lerobot_buds.envs import TASKS
from lerobot_buds.envs.loading import open_simulation

if TYPE_CHECKING:
    from lerobot_buds.envs.simulation.tabletop import TabletopEnv

SETTLE = np.array([0.0, 0.0, 0.0, -1.0])
Place = tuple[float, float, float]

# Everything done: pot on tray, tray aside, lid and tool on the table.
TRAY, POT, LID, TOOL = (0.02, 0.17, 0.9), (0.02, 0.17, 0.912), (-0.25, 0.2, 0.912), (0.0, 0.0, 0.92)


@pytest.fixture(scope="module")
def simulation() -> Iterator["TabletopEnv"]:
    simulation = open_simulation(TASKS["real_kitchen/full"])
    yield simulation
    simulation.close()


def start(simulation: "TabletopEnv", seed: int = 0) -> None:
    simulation.reset_with(np.random.default_rng(seed))
    for _ in range(5):
        simulation.step(SETTLE)


def arrange(
    simulation: "TabletopEnv", tray: Place = TRAY, pot: Place = POT, lid: Place = LID, tool: Place = TOOL
) -> None:
    for name, place in {"tray": tray, "pot": pot, "lid": lid, "tool": tool}.items():
        simulation.state.set_pose(name, np.array(place), 0.0)
    simulation.sim.forward()


def test_it_starts_at_rest_with_everything_to_do(simulation: "TabletopEnv") -> None:
    for seed in range(3):
        start(simulation, seed)
        assert {fact for fact, holds in simulation.facts().items() if holds} == {"tool_put_down"}
        assert not simulation.succeeded()
        before = [simulation.state.position(f"{name}_main") for name in ("tray", "pot", "lid", "tool")]
        for _ in range(10):
            simulation.step(SETTLE)
        after = [simulation.state.position(f"{name}_main") for name in ("tray", "pot", "lid", "tool")]
        np.testing.assert_allclose(before, after, atol=5e-4)


@pytest.mark.parametrize(
    ("fact", "places", "holds"),
    [
        ("lid_off", {}, True),
        ("lid_off", {"lid": (-0.25, 0.2, 0.939)}, True),
        ("lid_off", {"lid": (-0.25, 0.2, 0.941)}, False),
        ("lid_off", {"lid": (0.02, 0.271, 0.912)}, True),
        ("lid_off", {"lid": (0.02, 0.269, 0.912)}, False),
        ("pot_on_tray", {}, True),
        ("pot_on_tray", {"pot": (0.049, 0.17, 0.912)}, True),
        ("pot_on_tray", {"pot": (0.051, 0.17, 0.912)}, False),
        ("pot_on_tray", {"pot": (0.02, 0.199, 0.912)}, True),
        ("pot_on_tray", {"pot": (0.02, 0.139, 0.912)}, False),
        ("pot_on_tray", {"pot": (0.02, 0.17, 0.9035)}, True),
        ("pot_on_tray", {"pot": (0.02, 0.17, 0.9025)}, False),
        ("pot_on_tray", {"pot": (0.02, 0.17, 0.929)}, True),
        ("pot_on_tray", {"pot": (0.02, 0.17, 0.931)}, False),
        ("tray_aside", {"tray": (0.02, 0.141, 0.9)}, True),
        ("tray_aside", {"tray": (0.02, 0.139, 0.9)}, False),
        ("tool_lifted", {"tool": (0.0, 0.0, 0.941)}, True),
        ("tool_lifted", {"tool": (0.0, 0.0, 0.940)}, False),
        ("tool_put_down", {}, True),
        ("tool_put_down", {"tool": (0.0, 0.0, 0.929)}, True),
        ("tool_put_down", {"tool": (0.0, 0.0, 0.931)}, False),
    ],
)
def test_a_fact_holds_on_one_side_of_its_threshold(
    simulation: "TabletopEnv", fact: str, places: dict[str, Place], holds: bool
) -> None:
    start(simulation)
    arrange(simulation, **places)
    assert simulation.facts()[fact] is holds


def test_a_tool_that_the_hand_still_touches_is_not_put_down(simulation: "TabletopEnv") -> None:
    start(simulation)
    # Where the fingers are; the table is out of their reach, so the height alone would not tell.
    fingers = simulation.state.hand
    arrange(simulation, tool=(fingers[0], fingers[1] + simulation.state.fingers[0], fingers[2]))
    assert simulation.state.touching("tool", "gripper0")
    arrange(simulation)
    assert not simulation.state.touching("tool", "gripper0")
    assert simulation.facts()["tool_put_down"]


def test_the_tool_must_have_been_lifted_in_this_episode(simulation: "TabletopEnv") -> None:
    start(simulation)
    arrange(simulation)
    facts = simulation.facts()
    assert [name for name in simulation.scene.goal if not facts[name]] == ["tool_has_been_lifted"]
    arrange(simulation, tool=(0.0, -0.2, 1.0))
    simulation.step(SETTLE)
    arrange(simulation)
    assert simulation.succeeded()
    start(simulation)
    arrange(simulation)
    assert not simulation.succeeded()


@pytest.mark.parametrize(("body", "mass"), [("pot", 0.553), ("lid", 0.062), ("tray", 0.175), ("tool", 0.251)])
def test_objects_weigh_what_the_design_says(simulation: "TabletopEnv", body: str, mass: float) -> None:
    model = simulation.sim.model
    assert model.body_mass[model.body_name2id(f"{body}_main")] == pytest.approx(mass, rel=0.01)
