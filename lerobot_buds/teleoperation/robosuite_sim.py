"""The simulator as a LeRobot robot: one task behind ``connect``, ``get_observation`` and ``send_action``.

An action is executed once for every observation, as LeRobot's loops have it. Actions that no observation came before
are not: LeRobot slides an arm to a position by such, and a hand that takes displacements would drift. When an episode
begins is what LeRobot announces in its log (`announcements`); when it ends, the robot says by a key (`keys`). Where
nothing is announced (``lerobot-teleoperate``, ``lerobot-replay``, a rollout that is not recorded) the next scene
follows by itself.
"""

import logging
import time
from enum import Enum, auto
from pathlib import Path
from typing import Any

from lerobot.robots import Robot
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_buds.core import ConfigError
from lerobot_buds.demos.recording import EVALUATION_SEEDS
from lerobot_buds.envs import ACTION_NAMES, CAMERAS, FPS, STATE_NAMES, EnvSettings

from .announcements import Announcement, Announcements
from .config_robosuite_sim import RobosuiteSimConfig
from .ending import OrderlyEnd
from .journal import Journal
from .keys import keyboard, press
from .pace import Pace
from .page import open_page
from .scene import Scene, vector_of
from .session import Episode, Session

logger = logging.getLogger(__name__)


class Phase(Enum):
    """What LeRobot is doing, as far as the robot must know."""

    FREE = auto()
    """Nothing is announced, or a policy acts that may be corrected: scenes follow one another by themselves."""
    EPISODE = auto()
    """An episode is being recorded."""
    RESET = auto()
    """The next scene is shown, and nothing moves."""
    PAUSED = auto()
    """A policy was stopped for a person to take over; nothing moves."""
    CORRECTION = auto()
    """A person acts and is recorded, from amid an episode."""


class RobosuiteSim(Robot):  # type: ignore[misc]  # LeRobot ships no types
    """A robosuite task as a robot.

    It observes the state (``joint_1.pos`` to ``eef_z.pos``: rad, m) and both cameras ((H, W, 3) uint8), and takes the
    hand's displacement and the gripper's command, all in [-1, 1] (see `RobosuiteEnv`).

    Args:
        config: The task and how it is drawn.
    """

    config_class = RobosuiteSimConfig
    name = "robosuite_sim"

    def __init__(self, config: RobosuiteSimConfig) -> None:
        super().__init__(config)
        self.config = config
        self.cameras = dict(CAMERAS)  # LeRobot counts them
        self.pace = Pace()
        self._scene: Scene | None = None
        self._announcements = Announcements()
        self._end = OrderlyEnd()
        self._phase = Phase.FREE
        self._by_policy = False
        self._may_act = False
        self._asked_for_next = False
        self._shown_since = 0.0

    @property
    def observation_features(self) -> dict[str, type | tuple[int, int, int]]:
        """Names of the state -> float, names of the cameras -> shape ``(H, W, 3)``."""
        size = self.config.image_size
        return {**dict.fromkeys(STATE_NAMES, float), **dict.fromkeys(CAMERAS, (size, size, 3))}

    @property
    def action_features(self) -> dict[str, type]:
        """Names of the action -> float."""
        return dict.fromkeys(ACTION_NAMES, float)

    @property
    def is_connected(self) -> bool:
        """Whether the simulation is there."""
        return self._scene is not None

    @property
    def is_calibrated(self) -> bool:
        """Always: there is nothing to calibrate."""
        return True

    def calibrate(self) -> None:
        """Does nothing."""

    def configure(self) -> None:
        """Does nothing."""

    def connect(self, calibrate: bool = True) -> None:
        """Starts the simulation with the scene of the first seed, and listens and presses from now on.

        Args:
            calibrate: Of no meaning here.

        Raises:
            SimulatorError: The simulator is missing or unsupported.
            DatasetError: The dataset's record is damaged, or is of another task or drawn otherwise; or a recording into
                the same folder was killed and left its journal.
        """
        config = self.config
        settings = EnvSettings(config.task, config.episode_length, config.image_size, config.render_profile)
        root = None if config.dataset_root is None else Path(config.dataset_root).resolve()
        self._session = Session.begin(root, settings)
        self._journal = Journal(root, settings)
        self._journal.require_none()
        scene = Scene(settings, config.end_after_success_s)
        scene.begin(config.seed)
        self._scene = scene
        if not self._announcements.listen():
            logger.warning("LeRobot's log is off (below INFO), so that the robot cannot tell when episodes begin.")
        self._end.begin()
        keyboard().open()

    def get_observation(self) -> dict[str, Any]:
        """Shows state and cameras; of a new scene where one is due.

        Returns:
            State by name (rad, m) and images by camera ((H, W, 3) uint8).

        Raises:
            ConfigError: A person would demonstrate from a seed for evaluation.
            DatasetError: ``dataset_root`` is not the dataset that is recorded into, or that has another rate.
        """
        scene = self._connected()
        self._take_in()
        if self._phase is Phase.FREE and scene.ended:
            self._next_scene()
        if self._phase is Phase.EPISODE and scene.ended and not self._asked_for_next:
            self._asked_for_next = keyboard().press("next")  # LeRobot's listener may have begun to read by now
        if self._phase is Phase.RESET:
            self._end_reset()
        else:
            self.pace.tick()
        self._may_act = True
        if page := open_page():
            page.on_press = press
            page.show({name: scene.shown[name] for name in CAMERAS}, self.facts())
        return scene.shown

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        """Advances the simulation by one control step (50 ms), unless it is to stand still.

        It stands still while an episode is prepared or a policy paused, after an episode's end, for actions that no
        observation came before, and for joint positions, by which LeRobot sends an arm back to where it began.

        Args:
            action: Displacement of the hand and gripper by name, in [-1, 1].

        Returns:
            What of it was executed.

        Raises:
            SimulatorError: Names are missing, or the action or the simulation is not finite.
        """
        scene = self._connected()
        vector = vector_of(action)
        moves = self._phase in (Phase.FREE, Phase.CORRECTION) or (self._phase is Phase.EPISODE and not scene.ended)
        if vector is None or not self._may_act or not moves:
            return dict.fromkeys(ACTION_NAMES, 0.0)
        self._may_act = False
        had_ended = scene.ended
        executed = scene.act(vector)
        if self._phase is Phase.EPISODE:
            self._journal.add(vector)
        if scene.ended and not had_ended:
            self._tell_outcome()
            self._ask_for_next()
        return dict(zip(ACTION_NAMES, executed.tolist(), strict=True))

    def disconnect(self) -> None:
        """Writes the record of what was kept, and gives simulation, log, signals and keyboard back."""
        scene = self._connected()
        if scene.steps and not scene.ended:
            self._tell_outcome()
        self._close_episode()
        self._scene = None
        self._announcements.stop()
        self._end.stop()
        keyboard().release()
        scene.close()
        self._settle()
        self._journal.close()
        if self.pace.periods:
            logger.info("Simulated robot: %s.", self.pace.describe())
        if self.pace.differs_from(FPS):
            logger.warning("The loop did not run at the simulation's %d steps per second.", FPS)

    def facts(self) -> dict[str, Any]:
        """Tells what a display may show: task, seed, phase, steps, success, and which stages are done."""
        scene = self._connected()
        return {
            "task": self.config.task,
            "seed": scene.seed,
            "phase": self._phase.name.lower(),
            "steps": scene.steps,
            "succeeded": scene.succeeded,
            "stages": scene.stages,
            "episodes": len(self._session.kept),
        }

    def _connected(self) -> Scene:
        if self._scene is None:
            raise DeviceNotConnectedError(f"{self} is not connected.")
        return self._scene

    def _take_in(self) -> None:
        """Does what LeRobot's announcements ask for."""
        for what, number in self._announcements.heard():
            if what is Announcement.EPISODE:
                self._close_episode()
                self._session.start(number, FPS)
                self._settle()
                self._next_scene()
                if self._connected().seed < self._session.next_seed:  # this goes on with an earlier recording
                    self._connected().begin(self._session.next_seed)
                self._refuse_evaluation_seeds(by_policy=self._by_policy)
                self._phase, self._asked_for_next = Phase.EPISODE, False
            elif what is Announcement.RESET:
                self._close_episode()
                self._next_scene()
                self._phase, self._asked_for_next, self._shown_since = Phase.RESET, False, time.monotonic()
            elif what is Announcement.POLICY:
                self._by_policy = True
            elif what is Announcement.CORRECTIONS:
                self._refuse_evaluation_seeds(by_policy=False)
                self._session.start(None, FPS)
            elif what is Announcement.PAUSE:
                self._phase = Phase.PAUSED
            elif what is Announcement.CORRECTION:
                self._refuse_evaluation_seeds(by_policy=False)
                self._phase = Phase.CORRECTION
            elif what is Announcement.CORRECTION_SAVED:
                self._close_episode()
                self._settle()
                self._phase = Phase.PAUSED
            elif what is Announcement.RESUME:
                self._phase = Phase.FREE

    def _next_scene(self) -> None:
        """Sets up the scene of the next seed, unless this one is untouched."""
        scene = self._connected()
        if scene.steps:
            if not scene.ended:  # LeRobot or its user ended the episode; else its outcome was told
                self._tell_outcome()
            scene.begin(scene.seed + 1)
        self.pace.pause()

    def _close_episode(self) -> None:
        """Tells the session of the episode that ends, if one is recorded."""
        if self._phase in (Phase.EPISODE, Phase.CORRECTION):
            scene = self._connected()
            who = "correction" if self._phase is Phase.CORRECTION else "policy" if self._by_policy else "teleoperated"
            self._session.ended(Episode(scene.seed, scene.succeeded, who))

    def _settle(self) -> None:
        """Keeps record and journal of the last episode, if LeRobot has saved it."""
        if (episode := self._session.settle()) is not None:
            self._journal.keep(len(self._session.kept) - 1, episode)
        self._journal.begin_episode()

    def _tell_outcome(self) -> None:
        """Says how the episode ended, or how far it came."""
        scene = self._connected()
        outcome = "success" if scene.succeeded else "no success"
        logger.info("Seed %d: %s after %d steps (%.1f s).", scene.seed, outcome, scene.steps, scene.steps / FPS)

    def _ask_for_next(self) -> None:
        """Asks LeRobot for the next episode, where it records."""
        if self._phase is not Phase.EPISODE:
            return
        self._asked_for_next = keyboard().press("next")
        if not self._asked_for_next:
            logger.warning("LeRobot reads no keys here: the episode goes on, without motion, until its time is over.")

    def _end_reset(self) -> None:
        """Asks LeRobot for the episode once its scene was shown for long enough."""
        wait = self.config.new_scene_s
        if wait is not None and not self._asked_for_next and time.monotonic() - self._shown_since >= wait:
            self._asked_for_next = keyboard().press("next")

    def _refuse_evaluation_seeds(self, by_policy: bool) -> None:
        seed = self._connected().seed
        if seed >= EVALUATION_SEEDS and not by_policy:
            raise ConfigError(
                f"Seed {seed} is for evaluation: a person demonstrates from seeds below {EVALUATION_SEEDS}. Choose a "
                "smaller --robot.seed."
            )
