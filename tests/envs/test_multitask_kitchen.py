"""The goal's facts, on states made by hand on both sides of every threshold."""

import mujoco
import numpy as np
import pytest

from lerobot_buds.envs import TASKS

REGION = np.array([0.15, -0.02, 0.878])


@pytest.fixture
def facts(env):
    """Writes joints and poses, computes positions and contacts without moving anything, and evaluates the facts."""
    env.reset(seed=0)

    def facts(joints=(), poses=()):
        for name, value in joints:
            env.state.set_joint(name, value)
        for name, position in poses:
            env.state.set_pose(name, np.array(position), 0.0)
        sim = env.simulation.sim
        mujoco.mj_forward(sim.model._model, sim.data._data)
        return env.simulation.facts()

    return facts


def test_the_start_is_not_a_success_and_holds_what_the_task_says(env):
    for seed in range(5):
        _, info = env.reset(seed=seed)
        facts = env.simulation.facts()
        assert not info["is_success"] and not env.simulation.succeeded()
        assert facts["cube_in_pot"] and facts["stove_off"]
        assert not facts["drawer_closed"] and not facts["pot_in_region"]
        assert env.state.joint("cabinet_slide") == pytest.approx(-0.10, abs=0.005)


@pytest.mark.parametrize(("slide", "closed"), [(-0.011, False), (-0.009, True), (0.0, True), (-0.1, False)])
def test_drawer_closed(facts, slide, closed):
    assert facts(joints=[("cabinet_slide", slide)])["drawer_closed"] is closed


@pytest.mark.parametrize(("hinge", "on"), [(-0.25, False), (-0.001, False), (0.001, True), (0.3, True)])
def test_stove(env, facts, hinge, on):
    found = facts(joints=[("button_hinge", hinge)])
    assert (found["stove_on"], found["stove_off"]) == (on, not on)
    env.simulation.scene.update(env.state)
    model = env.simulation.sim.model
    assert model.geom_rgba[model.geom_name2id("stove_flame_visual")][3] == float(on)


@pytest.mark.parametrize(
    ("offset", "inside"),
    [
        ((0, 0, 0.02), True),
        ((0.049, 0, 0.02), True),
        ((0.051, 0, 0.02), False),
        ((-0.051, 0, 0.02), False),
        ((0, 0.099, 0.02), True),
        ((0, -0.101, 0.02), False),
        ((0, 0, 0.049), True),
        ((0, 0, 0.051), False),
    ],
)
def test_pot_in_region(facts, offset, inside):
    assert facts(poses=[("pot", REGION + offset)])["pot_in_region"] is inside


@pytest.mark.parametrize(
    ("position", "on"),
    [
        ((0.05, 0.20, 0.92), True),
        ((0.129, 0.20, 0.92), True),
        ((0.131, 0.20, 0.92), False),
        ((0.05, 0.119, 0.92), False),
        ((0.05, 0.20, 0.926), False),
        ((0.05, 0.20, 0.899), False),
    ],
)
def test_pot_on_stove(facts, position, on):
    assert facts(poses=[("pot", position)])["pot_on_stove"] is on


@pytest.mark.parametrize(
    ("cube", "inside"),
    [
        ((0.0, 0.0, 0.0270), True),  # on the pot's floor, 0.5 mm deep
        ((0.0, 0.0, 0.0290), False),  # 1.5 mm above the floor: no contact
        ((0.071, 0.0, 0.0325), False),  # presses on the outside of a wall
        ((0.0, 0.06, 0.105), False),  # on top of a handle
    ],
)
def test_a_cube_is_in_the_pot_only_if_it_touches_and_is_between_the_walls(env, facts, cube, inside):
    pot = np.array([0.0, 0.0, 0.9035])
    assert facts(poses=[("pot", pot), ("cube", pot + cube)])["cube_in_pot"] is inside
    assert env.state.touching("cube", "pot") is (cube != (0.0, 0.0, 0.0290))


def test_success_needs_every_fact_of_the_goal(env, facts):
    goal = TASKS[env.task].goal
    pot = np.array([0.15, 0.0, 0.9035])
    cube = pot + np.array([0, 0, 0.027])
    served = {"joints": [("cabinet_slide", 0.0), ("button_hinge", -0.2)], "poses": [("pot", pot), ("cube", cube)]}
    spoiled = {
        "drawer_closed": [("cabinet_slide", -0.05)],
        "stove_off": [("button_hinge", 0.2)],
    }
    assert all(facts(**served)[name] for name in goal) and env.simulation.succeeded()
    for name, joints in spoiled.items():
        assert not facts(joints=joints)[name] and not env.simulation.succeeded()
        facts(**served)
    assert env.simulation.succeeded()
    facts(poses=[("cube", (0.0, 0.2, 0.95))])
    assert not env.simulation.succeeded()


def test_starts_follow_the_zoo_ranges_and_vary(env):
    places = []
    for seed in range(8):
        env.reset(seed=seed)
        places.append(env.state.position("pot_main"))
    places = np.array(places)
    assert (places[:, 0] > 0.009).all() and (places[:, 0] < 0.051).all()
    assert (np.abs(places[:, 1]) < 0.021).all()
    assert np.ptp(places[:, 0]) > 0.01 and np.ptp(places[:, 1]) > 0.01
