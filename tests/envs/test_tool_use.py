from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

from lerobot_buds.envs import TASKS, EnvSettings, RobosuiteEnv
from lerobot_buds.envs.loading import open_simulation

if TYPE_CHECKING:
    from lerobot_buds.envs.simulation.tabletop import TabletopEnv

POT = np.array([0.0, 0.18, 0.9025])


@pytest.fixture(scope="module")
def simulation() -> Iterator["TabletopEnv"]:
    simulation = open_simulation(TASKS["tool_use/full"])
    yield simulation
    simulation.close()


@pytest.mark.parametrize(
    ("offset", "touching", "success"),
    [
        ((0.0, 0.0, 0.027), True, True),  # lying on the pot's floor
        ((0.0, 0.0, 0.040), False, False),  # hovering inside
        ((0.0, 0.059, 0.030), True, True),
        ((0.0, 0.061, 0.030), True, False),
        ((0.03, 0.0, 0.049), True, True),
        ((0.03, 0.0, 0.051), True, False),
    ],
)
def test_success_needs_contact_and_closeness(
    simulation: "TabletopEnv", offset: tuple[float, float, float], touching: bool, success: bool
) -> None:
    simulation.reset_with(np.random.default_rng(0))
    simulation.state.set_pose("pot", POT, 0.0)
    simulation.state.set_pose("cube", POT + offset, -np.pi / 2)
    simulation.sim.forward()
    assert simulation.state.touching("cube", "pot") is touching
    assert simulation.succeeded() is success


def test_the_cube_starts_out_of_reach_and_the_tool_within(simulation: "TabletopEnv") -> None:
    reach = TASKS["tool_use/full"].workspace[0][1]
    for seed in range(20):
        simulation.reset_with(np.random.default_rng(seed))
        assert not simulation.succeeded()
        cube, tool = simulation.state.position("cube_main"), simulation.state.position("tool_main")
        assert 0.09 <= cube[0] <= 0.12
        assert -0.25 <= cube[1] <= -0.10
        assert cube[0] - 0.025 > reach
        assert tool[0] + 0.11 < reach


def test_the_short_task_starts_with_the_cube_within_reach_and_the_tool_clear_of_it() -> None:
    task = TASKS["tool_use/cube_fetched"]
    simulation = open_simulation(task)
    for seed in range(20):
        simulation.reset_with(np.random.default_rng(seed))
        assert not simulation.succeeded()
        cube, tool = simulation.state.position("cube_main"), simulation.state.position("tool_main")
        assert cube[0] + 0.025 < task.workspace[0][1]
        assert abs(cube[1] - tool[1]) > 0.09
    simulation.close()


def test_the_tool_weighs_what_the_original_weighs(simulation: "TabletopEnv") -> None:
    model = simulation.sim.model
    assert model.body_mass[model.body_name2id("tool_main")] == pytest.approx(0.2512, abs=1e-4)


def test_the_hand_is_not_sent_beyond_the_workspace() -> None:
    env = RobosuiteEnv(EnvSettings("tool_use/full"))
    env.simulation.reset_with(np.random.default_rng(0))
    forward = np.array([1.0, 0.0, 0.0, -1.0], dtype=np.float32)
    furthest = -1.0
    for _ in range(40):
        executed = env.executed(forward)
        np.testing.assert_array_equal(env.executed(executed), executed)
        assert env.state.hand[0] + 0.05 * executed[0] <= 0.03 + 1e-6
        env.simulation.step(executed.astype(np.float64))
        furthest = max(furthest, env.state.hand[0])
    assert furthest < 0.045  # its momentum takes it a little further than it is sent
    assert env.state.hand[0] == pytest.approx(0.03, abs=0.004)
    env.close()


def test_a_hand_beyond_the_workspace_is_sent_back(monkeypatch: pytest.MonkeyPatch) -> None:
    env = RobosuiteEnv(EnvSettings("tool_use/full"))
    env.simulation.reset_with(np.random.default_rng(0))
    monkeypatch.setattr(type(env.state), "hand", np.array([0.05, 0.0, 1.0]))
    np.testing.assert_allclose(env.executed(np.array([0.5, 2.0, -2.0, 1.0])), [-0.4, 1.0, -1.0, 1.0], atol=1e-6)
    env.close()
