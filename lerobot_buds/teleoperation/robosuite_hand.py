"""A person who moves the hand of our environments, as a LeRobot teleoperator."""

from typing import Any

from lerobot.processor import RobotAction
from lerobot.teleoperators import Teleoperator
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_buds.envs import ACTION_NAMES

from .announcements import Announcement, Announcements
from .config_robosuite_hand import RobosuiteHandConfig
from .devices import Device, Gamepad, Keyboard, PageKeys, SpaceMouse
from .displacement import DisplacementStep


class RobosuiteHand(Teleoperator):  # type: ignore[misc]  # LeRobot ships no types
    """Reads a device and gives actions of our environments.

    LeRobot records what a teleoperator gives and its commands take no processor, so the conversion is in here.

    Args:
        config: The device and the speed.
    """

    config_class = RobosuiteHandConfig
    name = "robosuite_hand"

    def __init__(self, config: RobosuiteHandConfig) -> None:
        super().__init__(config)
        self.config = config
        self._step = DisplacementStep(config.speed)
        self._device: Device | None = None
        self._announcements = Announcements()

    @property
    def action_features(self) -> dict[str, type]:
        """Names of the action's dimensions."""
        return dict.fromkeys(ACTION_NAMES, float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """None: a person sees."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether the device is open."""
        return self._device is not None

    @property
    def is_calibrated(self) -> bool:
        """Always: nothing has to be measured."""
        return True

    def connect(self, calibrate: bool = True) -> None:
        """Opens the device.

        Args:
            calibrate: Means nothing here.

        Raises:
            ConfigError: What the device needs is missing, or there is none.
        """
        if self._device is None:
            device = _device(self.config)
            device.connect()
            self._device = device
            self._step.reset()
            self._announcements.listen()

    def calibrate(self) -> None:
        """Does nothing."""

    def configure(self) -> None:
        """Does nothing."""

    def get_action(self) -> RobotAction:
        """Tells what the person wants now, see `DisplacementStep`.

        Raises:
            DeviceNotConnectedError: The device is not open, or was unplugged.
            KeyboardInterrupt: The person ended it at the keyboard.
        """
        if self._device is None:
            raise DeviceNotConnectedError(f"The {self.config.device} is not open: connect() comes first.")
        if any(what is Announcement.EPISODE for what, _ in self._announcements.heard()):
            self._step.reset()  # the hand is open again, whatever was last asked for
        return self._step.action(self._device.read())

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Does nothing."""

    def disconnect(self) -> None:
        """Closes the device; may be called twice."""
        self._announcements.stop()
        device, self._device = self._device, None
        if device is not None:
            device.disconnect()


def _device(config: RobosuiteHandConfig) -> Device:
    if config.device == "page":
        return PageKeys(config.port)
    kinds: dict[str, type[Keyboard | Gamepad | SpaceMouse]]
    kinds = {"keyboard": Keyboard, "gamepad": Gamepad, "spacemouse": SpaceMouse}
    return kinds[config.device]()
