"""The teleoperator with every device but the page, by stand-ins where a device would have to be plugged in."""

import logging
import sys
from types import ModuleType, SimpleNamespace

import lerobot.teleoperators.gamepad
import lerobot.teleoperators.keyboard
import pytest
from lerobot.teleoperators import TeleoperatorConfig, make_teleoperator_from_config
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_buds import plugin  # noqa: F401
from lerobot_buds.core import ConfigError
from lerobot_buds.envs import ACTION_NAMES
from lerobot_buds.teleoperation.config_robosuite_hand import RobosuiteHandConfig
from lerobot_buds.teleoperation.devices import Keyboard, SpaceMouse
from lerobot_buds.teleoperation.robosuite_hand import RobosuiteHand

AWAY, STILL = [-0.625, 0.0, 0.0, -1.0], [0.0, 0.0, 0.0, -1.0]


def given(hand):
    action = hand.get_action()
    assert list(action) == ACTION_NAMES == list(hand.action_features)
    return list(action.values())


class Keys(lerobot.teleoperators.keyboard.KeyboardTeleop):
    """LeRobot's keyboard, with a listener that a test plays."""

    listening = True

    @property
    def is_connected(self):
        return self.listener is not None

    def connect(self):
        self.listener = self.listening or None

    def disconnect(self):
        self.listener = None


@pytest.fixture
def keyboard(hand, monkeypatch):
    monkeypatch.setattr(lerobot.teleoperators.keyboard, "KeyboardTeleop", Keys)
    opened = hand()
    opened.connect()
    return opened, opened._device._keys


class Pad:
    """LeRobot's gamepad with what it reads."""

    plugged, action = 1, {"delta_x": 1.0, "delta_y": 0.0, "delta_z": 0.0, "gripper": 1}

    def __init__(self, _config):
        self.gamepad = None

    def connect(self):
        self.gamepad = SimpleNamespace(running=self.plugged > 0)

    def get_action(self):
        return dict(self.action)

    def disconnect(self):
        self.gamepad = None


@pytest.fixture
def pads(monkeypatch):
    pad = type("Pads", (Pad,), {})
    monkeypatch.setattr(lerobot.teleoperators.gamepad, "GamepadTeleop", pad)
    pygame = ModuleType("pygame")
    pygame.joystick = SimpleNamespace(get_count=lambda: pad.plugged)
    monkeypatch.setitem(sys.modules, "pygame", pygame)
    return pad


class Mouse:
    """The plugin's teleoperator, as release 1.0 answers."""

    is_connected, fails = True, None

    def connect(self):
        if self.fails:
            raise self.fails

    def get_action(self):
        if self.fails:
            raise self.fails
        turned = {"target_wx": 0.3, "target_wy": 0.2, "target_wz": 0.1}
        return {"enabled": True, "target_x": 0.4, "target_y": -1.0, "target_z": 0.0, **turned, "gripper_vel": -1.0}

    def disconnect(self):
        self.is_connected = False


@pytest.fixture
def mouse(monkeypatch):
    only, module = Mouse(), ModuleType("lerobot_teleoperator_spacemouse")
    module.SpaceMouseTeleopConfig, module.SpaceMouseTeleop = SimpleNamespace, lambda config: only
    monkeypatch.setitem(sys.modules, module.__name__, module)
    return only


def test_lerobot_finds_it_by_its_type(tmp_path):
    config = TeleoperatorConfig.get_choice_class("robosuite_hand")(calibration_dir=tmp_path)
    made = make_teleoperator_from_config(config)
    assert type(made) is RobosuiteHand and made.is_calibrated and not made.is_connected
    with pytest.raises(DeviceNotConnectedError, match=r"connect\(\) comes first"):
        made.get_action()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"device": "gamepda"}, "no device 'gamepda'. Did you mean 'gamepad'"),
        ({"speed": 0.0}, "speed=0 cannot work"),
        ({"speed": 1.5}, r"speed=1.5 cannot work"),
        ({"port": 70000}, "port=70000 is none"),
    ],
)
def test_settings_that_cannot_work(settings, message):
    with pytest.raises(ConfigError, match=message):
        RobosuiteHandConfig(**settings)


def test_keys_are_held_until_they_are_let_go(keyboard):
    hand, keys = keyboard
    assert given(hand) == STILL
    keys.event_queue.put(("w", True))
    assert [given(hand), given(hand)] == [AWAY, AWAY]
    keys.event_queue.put(("w", False))
    assert given(hand) == STILL


def test_a_key_let_go_under_shift_is_let_go(keyboard):
    hand, keys = keyboard
    keys.event_queue.put(("w", True))
    keys.event_queue.put((SimpleNamespace(name="shift"), True))  # as pynput's enumeration is
    assert given(hand) == [pytest.approx(-0.1875), 0, 0, -1]
    keys.event_queue.put(("W", False))
    keys.event_queue.put((None, True))  # a dead key has no character
    assert given(hand) == STILL


def test_escape_ends_after_the_frame_that_a_recording_is_in(keyboard):
    hand, keys = keyboard
    keys.event_queue.put(("w", True))
    keys.event_queue.put((SimpleNamespace(name="esc"), False))
    assert [given(hand) for _ in range(Keyboard.GRACE)] == [STILL] * Keyboard.GRACE
    with pytest.raises(KeyboardInterrupt):
        hand.get_action()
    hand.disconnect()
    assert not hand.is_connected


def test_an_episode_begins_with_an_open_hand(keyboard, caplog):
    hand, keys = keyboard
    keys.event_queue.put(("j", True))
    with caplog.at_level("INFO"):
        assert given(hand)[3] == 1
        keys.event_queue.put(("j", False))
        assert given(hand)[3] == 1
        logging.info("Recording episode 1")  # as LeRobot does
        assert given(hand)[3] == -1


def test_a_keyboard_that_cannot_be_heard(hand, monkeypatch):
    monkeypatch.setattr(lerobot.teleoperators.keyboard, "KeyboardTeleop", type("Deaf", (Keys,), {"listening": False}))
    deaf = hand()
    with pytest.raises(ConfigError, match=r"X11 session.*--teleop.device=page"):
        deaf.connect()
    assert not deaf.is_connected


def test_pynput_is_named_where_it_is_missing(hand, monkeypatch):
    def missing(_config):
        raise ImportError("'pynput' is required but not installed.")

    monkeypatch.setattr(lerobot.teleoperators.keyboard, "KeyboardTeleop", missing)
    with pytest.raises(ConfigError, match=r"needs pynput.*pip install 'lerobot_policy_buds\[teleop\]'"):
        hand().connect()


def test_a_gamepad_until_it_is_unplugged(hand, pads):
    held = hand(device="gamepad")
    held.connect()
    held.connect()
    assert given(held) == AWAY
    pads.plugged = 0
    with pytest.raises(DeviceNotConnectedError, match="gamepad was unplugged"):
        held.get_action()
    held.disconnect()
    held.disconnect()


def test_there_is_no_gamepad(hand, pads):
    pads.plugged = 0
    with pytest.raises(ConfigError, match="No gamepad was found"):
        hand(device="gamepad").connect()


def test_pygame_is_named_where_it_is_missing(hand, pads, monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ConfigError, match=r"needs pygame.*pip install 'lerobot_policy_buds\[teleop\]'"):
        hand(device="gamepad").connect()


def test_a_spacemouse_until_it_is_unplugged(hand, mouse):
    held = hand(device="spacemouse")
    held.connect()
    assert given(held) == [-0.25, 0.625, 0.0, 1.0]
    mouse.fails = OSError("read error")
    with pytest.raises(DeviceNotConnectedError, match=r"SpaceMouse was unplugged \(read error\)"):
        held.get_action()
    mouse.fails, mouse.is_connected = None, False
    with pytest.raises(DeviceNotConnectedError, match="SpaceMouse was unplugged"):
        held.get_action()


def test_a_spacemouse_that_may_not_be_opened(hand, mouse):
    mouse.fails = PermissionError("hidraw permissions are missing")
    with pytest.raises(ConfigError, match="SpaceMouse cannot be opened: hidraw"):
        hand(device="spacemouse").connect()


def test_the_plugin_is_named_where_it_is_missing(hand):
    assert SpaceMouse.PACKAGE == "lerobot-teleoperator-spacemouse"
    with pytest.raises(ConfigError, match="pip install 'lerobot-teleoperator-spacemouse'"):
        hand(device="spacemouse").connect()
