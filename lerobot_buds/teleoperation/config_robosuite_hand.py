"""The teleoperator type ``robosuite_hand`` on LeRobot's command line."""

from dataclasses import dataclass

from lerobot.teleoperators import TeleoperatorConfig

from lerobot_buds.core import ConfigError, near_names

from .layout import PAPER_SPEED

DEVICES = ("keyboard", "gamepad", "spacemouse", "page")


@TeleoperatorConfig.register_subclass("robosuite_hand")
@dataclass(kw_only=True)
class RobosuiteHandConfig(TeleoperatorConfig):  # type: ignore[misc]  # LeRobot ships no types
    """A person who moves the hand of our environments, for ``lerobot-teleoperate`` and ``lerobot-record``.

    Attributes:
        device: ``keyboard``, ``gamepad``, ``spacemouse``, or ``page``: a page in the browser, with the cameras.
        speed: The largest displacement along an axis, of the 1 that the environments take; see `PAPER_SPEED`.
        port: Where the page is served, on this machine alone; 0 for any port that is free.
    """

    device: str = "keyboard"
    speed: float = PAPER_SPEED
    port: int = 8470

    def __post_init__(self) -> None:
        if self.device not in DEVICES:
            raise ConfigError(f"There is no device {self.device!r}. {near_names(self.device, DEVICES)}")
        if not 0 < self.speed <= 1:
            raise ConfigError(f"speed={self.speed:g} cannot work; the environments take more than 0 and at most 1.")
        if not 0 <= self.port < 65536:
            raise ConfigError(f"port={self.port} is none; ports are numbered 1 to 65535, and 0 takes any that is free.")
