"""From what an operator asks for to what our environments do: into the world's axes, at the speed of the paper.

The operator sees the workspace camera's image. That camera faces the robot: away from the viewer is along -x, the right
of the image along +y, up is up.
"""

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs import FeatureType, PipelineFeatureType, PolicyFeature
from lerobot.processor import ProcessorStepRegistry, RobotAction, RobotActionProcessorStep

from lerobot_buds.envs import ACTION_NAMES

from .layout import CLOSE, OPEN, PAPER_SPEED

OPENS, CLOSES = -1.0, 1.0
"""Commands of the gripper in our environments."""


@ProcessorStepRegistry.register("buds_displacement")
@dataclass
class DisplacementStep(RobotActionProcessorStep):  # type: ignore[misc]  # LeRobot ships no types
    """Turns the actions of LeRobot's gamepad into those of our environments.

    It takes ``delta_x`` (away from the operator), ``delta_y`` (to the left), ``delta_z`` (up), each in [-1, 1], and
    ``gripper`` (0 closes, 1 stays, 2 opens), and gives `ACTION_NAMES`: a displacement in the world's axes in [-1, 1] (1
    aims 5 cm ahead) and the gripper (-1 opens, +1 closes). A gripper that stays keeps its last command.

    Attributes:
        speed: The largest displacement along an axis, in (0, 1].
        gripper: The gripper's last command; an episode of ours begins with one that opens.
    """

    speed: float = PAPER_SPEED
    gripper: float = field(default=OPENS, init=False)

    def action(self, action: RobotAction) -> RobotAction:
        """Converts one action, see the class."""
        self.gripper = {CLOSE: CLOSES, OPEN: OPENS}.get(float(action["gripper"]), self.gripper)
        away, left, up = (self.speed * float(action[f"delta_{axis}"]) for axis in "xyz")
        # Zero less a zero is no negative zero, which would be recorded as a second kind of rest.
        return dict(zip(ACTION_NAMES, (0.0 - away, 0.0 - left, 0.0 + up, self.gripper), strict=True))

    def reset(self) -> None:
        """Forgets the gripper's last command."""
        self.gripper = OPENS

    def get_config(self) -> dict[str, Any]:
        """Lists what a pipeline's file keeps of it."""
        return {"speed": self.speed}

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Names the actions that come out."""
        names = dict.fromkeys(ACTION_NAMES, PolicyFeature(type=FeatureType.ACTION, shape=(1,)))
        return {**features, PipelineFeatureType.ACTION: names}
