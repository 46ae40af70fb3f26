"""An operator's action becomes one of our environments."""

import numpy as np
import pytest
from lerobot.configs import PipelineFeatureType
from lerobot.processor import ProcessorStepRegistry

from lerobot_buds.envs import ACTION_NAMES, EnvSettings, RobosuiteEnv
from lerobot_buds.teleoperation.displacement import DisplacementStep
from lerobot_buds.teleoperation.layout import CLOSE, OPEN, PAPER_SPEED, STAY, action_of


def asked(**values):
    return {"delta_x": 0.0, "delta_y": 0.0, "delta_z": 0.0, "gripper": STAY, **values}


def test_the_worlds_axes_at_the_speed_of_the_paper():
    step = DisplacementStep()
    assert step.speed == PAPER_SPEED
    moved = DisplacementStep(0.5).action(asked(delta_x=np.float32(1), delta_y=0.5, delta_z=-0.25))
    assert moved == dict(zip(ACTION_NAMES, (-0.5, -0.25, -0.125, -1.0), strict=True))
    assert all(type(value) is float for value in moved.values())
    assert [str(value) for value in step.action(asked()).values()] == ["0.0", "0.0", "0.0", "-1.0"]


def test_the_gripper_keeps_its_last_command():
    step = DisplacementStep()
    said = [step.action(asked(gripper=g))[ACTION_NAMES[3]] for g in (STAY, CLOSE, STAY, STAY, OPEN, STAY, CLOSE)]
    assert said == [-1, 1, 1, 1, -1, -1, 1]
    step.reset()
    assert step.action(asked())[ACTION_NAMES[3]] == -1


def test_it_is_a_registered_step_of_lerobots():
    assert ProcessorStepRegistry.get("buds_displacement") is DisplacementStep
    assert DisplacementStep(**DisplacementStep(0.4).get_config()) == DisplacementStep(0.4)
    features = DisplacementStep().transform_features({PipelineFeatureType.ACTION: {}})
    assert list(features[PipelineFeatureType.ACTION]) == ACTION_NAMES


@pytest.fixture(scope="module")
def env():
    opened = RobosuiteEnv(EnvSettings("tool_use/cube_fetched", draws=False))
    yield opened
    opened.close()


@pytest.mark.parametrize(("key", "axis", "sign"), [("w", 1, 1), ("s", 1, -1), ("d", 0, 1), ("a", 0, -1), ("i", 1, 1)])
def test_the_hand_moves_in_the_image_as_the_key_says(env, key, axis, sign):
    """Right and up in the image of the workspace camera are its frame's first and second axis."""
    env.reset(seed=0)
    began = env.state.hand.copy()
    for _ in range(8):
        env.step(np.array(list(DisplacementStep().action(action_of({key})).values()), np.float32))
    sim = env.simulation.sim
    camera = sim.data.cam_xmat[sim.model.camera_name2id("agentview")].reshape(3, 3)
    moved = camera[:, :2].T @ (env.state.hand - began)
    assert sign * moved[axis] > 0.02 and abs(moved[axis]) > 5 * abs(moved[1 - axis])
