from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

from lerobot_buds.envs import TASKS
from lerobot_buds.envs.loading import open_simulation

if TYPE_CHECKING:
    from lerobot_buds.envs.simulation.tabletop import TabletopEnv


@pytest.fixture(scope="module")
def simulation() -> Iterator["TabletopEnv"]:
    simulation = open_simulation(TASKS["hammer_place/full"])
    yield simulation
    simulation.close()


@pytest.mark.parametrize(
    ("y", "z", "drawer", "success"),
    [
        (0.265, 0.962, 0.0, True),
        (0.265, 0.941, 0.0, True),
        (0.265, 0.939, 0.0, False),
        (0.265, 0.999, 0.0, True),
        (0.265, 1.001, 0.0, False),
        (0.265, 1.047, 0.0, False),  # on top of the cabinet
        (0.221, 0.962, 0.0, True),
        (0.219, 0.962, 0.0, False),
        (0.265, 0.962, -0.009, True),
        (0.265, 0.962, -0.011, False),
    ],
)
def test_success_needs_the_hammer_inside_and_the_drawer_closed(
    simulation: "TabletopEnv", y: float, z: float, drawer: float, success: bool
) -> None:
    simulation.reset_with(np.random.default_rng(0))
    simulation.state.set_pose("hammer", np.array([0.0, y, z]), 0.0)
    simulation.state.set_joint("cabinet_slide", drawer)
    simulation.sim.forward()
    assert simulation.succeeded() is success


def test_the_hammer_starts_flat_with_its_face_to_either_side(simulation: "TabletopEnv") -> None:
    faces = set()
    for seed in range(20):
        simulation.reset_with(np.random.default_rng(seed))
        assert not simulation.succeeded()
        state = simulation.state
        for _ in range(5):
            simulation.step(np.array([0.0, 0.0, 0.0, -1.0]))
        hammer = state.position("hammer_main")
        assert -0.11 < hammer[0] < -0.01
        assert -0.21 < hammer[1] < -0.12
        assert hammer[2] == pytest.approx(0.913, abs=0.003)
        head = state.point_on("hammer_main", np.array([1.0, 0.0, 0.0])) - hammer
        assert head[0] > 0.99
        faces.add(np.sign(state.point_on("hammer_main", np.array([0.0, 1.0, 0.0]))[1] - hammer[1]))
    assert faces == {-1.0, 1.0}


def test_the_drawer_opens_wide_enough_for_the_hammer(simulation: "TabletopEnv") -> None:
    simulation.reset_with(np.random.default_rng(0))
    joint = simulation.sim.model.joint_name2id("cabinet_slide")
    body = simulation.sim.model.body_name2id("cabinet_drawer")
    simulation.sim.data.xfrc_applied[body][1] = -60.0
    for _ in range(60):
        simulation.step(np.array([0.0, 0.0, 0.0, -1.0]))
    simulation.sim.data.xfrc_applied[body][1] = 0.0
    assert simulation.sim.model.jnt_limited[joint] == 0
    assert simulation.state.joint("cabinet_slide") == pytest.approx(-0.135, abs=0.005)


def test_the_hammer_weighs_what_the_original_weighs(simulation: "TabletopEnv") -> None:
    model = simulation.sim.model
    assert model.body_mass[model.body_name2id("hammer_main")] == pytest.approx(0.0141, abs=2e-4)
