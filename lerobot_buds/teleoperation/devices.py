"""What a person holds: each device in the terms of LeRobot's gamepad, see `layout.action_of`.

A device raises `ConfigError` where it cannot be opened, and LeRobot's `DeviceNotConnectedError` once it is gone: that
ends a recording in order, with all episodes that were saved.
"""

from collections.abc import Callable
from importlib import import_module
from queue import Queue
from typing import Any, Protocol

from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_buds.core import ConfigError

from .layout import STAY, action_of
from .page import Page

OUR_EXTRA = "lerobot_policy_buds[teleop]"


class Device(Protocol):
    """A source of an operator's actions."""

    def connect(self) -> None:
        """Opens it."""
        ...

    def read(self) -> dict[str, float]:
        """Tells what the operator asks for now."""
        ...

    def disconnect(self) -> None:
        """Closes it; may be called twice."""
        ...


class _NamedKeys(Queue[tuple[str, bool]]):
    """Takes events by the key's name: under shift ``w`` is let go as ``W``, and would stay held.

    Attributes:
        ended: Escape was let go, by which LeRobot's keyboard ends. Its listener says so at the next key alone.
    """

    ended = False

    def put(self, item: tuple[Any, bool], block: bool = True, timeout: float | None = None) -> None:
        key, pressed = item
        name = key.lower() if isinstance(key, str) else getattr(key, "name", None)
        self.ended |= name == "esc" and not pressed
        if name is not None:
            super().put((name, pressed), block, timeout)


class Keyboard:
    """The keyboard by LeRobot's `KeyboardTeleop`, which hears every key of the desktop, whatever window is in front.

    LeRobot's `KeyboardEndEffectorTeleop` would steer by arrows, which end and repeat episodes in ``lerobot-record``.
    """

    GRACE = 2
    """Reads after Escape that still answer: the loop of a recording may be between looking and asking. Then it ends."""

    def __init__(self) -> None:
        self._keys: Any = None
        self._events = _NamedKeys()
        self._last_reads = self.GRACE

    def connect(self) -> None:
        """Begins to listen.

        Raises:
            ConfigError: pynput is missing, or cannot listen here.
        """
        from lerobot.teleoperators.keyboard import KeyboardTeleop, KeyboardTeleopConfig

        try:
            self._keys = KeyboardTeleop(KeyboardTeleopConfig())
        except ImportError as error:
            raise ConfigError(_missing("pynput", "The keyboard", OUR_EXTRA)) from error
        self._keys.event_queue = self._events
        self._keys.connect()
        if not self._keys.is_connected:
            raise ConfigError(
                "The keyboard cannot be heard here: that takes an X11 session (no Wayland, no terminal over ssh). "
                "Choose --teleop.device=page, or a gamepad."
            )

    def read(self) -> dict[str, float]:
        """Tells what the keys ask for that are held.

        Raises:
            KeyboardInterrupt: Escape was pressed, by which LeRobot's keyboard ends; its loop knows no other end.
        """
        if self._keys.is_connected and not self._events.ended:
            return action_of(self._keys.get_action().keys())
        if self._last_reads == 0:
            raise KeyboardInterrupt("Escape was pressed.")
        self._last_reads -= 1
        return action_of(set())

    def disconnect(self) -> None:
        """Listens no more."""
        if self._keys is not None and self._keys.is_connected:
            self._keys.disconnect()


class Gamepad:
    """A gamepad by LeRobot's `GamepadTeleop`: sticks move the hand, the lower triggers close and open."""

    def __init__(self) -> None:
        self._pad: Any = None
        self._count: Callable[[], int] = lambda: 0

    def connect(self) -> None:
        """Opens the first gamepad.

        Raises:
            ConfigError: pygame is missing, or there is no gamepad.
        """
        from lerobot.teleoperators.gamepad import GamepadTeleop, GamepadTeleopConfig

        pad = GamepadTeleop(GamepadTeleopConfig())
        try:
            pad.connect()
            self._count = import_module("pygame").joystick.get_count
        except ImportError as error:
            raise ConfigError(_missing("pygame", "A gamepad", OUR_EXTRA)) from error
        if not pad.gamepad.running:
            pad.disconnect()
            raise ConfigError("No gamepad was found. Plug one in, or choose another --teleop.device.")
        self._pad, self._pads = pad, self._count()

    def read(self) -> dict[str, float]:
        """Tells what sticks and triggers ask for.

        Raises:
            DeviceNotConnectedError: The gamepad was unplugged: LeRobot would go on with its last reading, or none.
        """
        action: dict[str, float] = self._pad.get_action()
        if self._count() < self._pads:
            raise DeviceNotConnectedError("The gamepad was unplugged.")
        return action

    def disconnect(self) -> None:
        """Closes it."""
        if self._pad is not None:
            self._pad.disconnect()


class SpaceMouse:
    """A SpaceMouse by the plugin ``lerobot-teleoperator-spacemouse``: the left button closes, the right one opens."""

    PACKAGE = "lerobot-teleoperator-spacemouse"

    def __init__(self) -> None:
        self._mouse: Any = None

    def connect(self) -> None:
        """Opens the first SpaceMouse.

        Raises:
            ConfigError: The plugin is missing, or there is no SpaceMouse that may be opened.
        """
        try:
            plugin = import_module(self.PACKAGE.replace("-", "_"))
            mouse = plugin.SpaceMouseTeleop(plugin.SpaceMouseTeleopConfig())
            mouse.connect()
        except ImportError as error:
            raise ConfigError(_missing(self.PACKAGE, "A SpaceMouse", self.PACKAGE)) from error
        except (OSError, RuntimeError) as error:
            raise ConfigError(f"The SpaceMouse cannot be opened: {error}") from error
        self._mouse = mouse

    def read(self) -> dict[str, float]:
        """Tells what puck and buttons ask for; turning the puck does nothing.

        Raises:
            DeviceNotConnectedError: The SpaceMouse was unplugged.
        """
        try:
            read = self._mouse.get_action()
        except OSError as error:
            raise DeviceNotConnectedError(f"The SpaceMouse was unplugged ({error}).") from error
        if not self._mouse.is_connected:
            raise DeviceNotConnectedError("The SpaceMouse was unplugged.")
        return {**{f"delta_{axis}": read[f"target_{axis}"] for axis in "xyz"}, "gripper": STAY + read["gripper_vel"]}

    def disconnect(self) -> None:
        """Closes it."""
        if self._mouse is not None:
            self._mouse.disconnect()


class PageKeys:
    """The keys of a page in the browser, which shows the cameras, too.

    Args:
        port: Where it is served; 0 for any port that is free.
    """

    def __init__(self, port: int) -> None:
        self._page = Page(port)

    def connect(self) -> None:
        """Serves the page.

        Raises:
            ConfigError: The port is taken.
        """
        self._page.start()

    def read(self) -> dict[str, float]:
        """Tells what the keys ask for that are held in it; nothing while nobody has it open."""
        return action_of(self._page.held())

    def disconnect(self) -> None:
        """Ends the page."""
        self._page.stop()


def _missing(package: str, device: str, install: str) -> str:
    return f"{device} needs {package}, which is not installed. Run: pip install '{install}'"
