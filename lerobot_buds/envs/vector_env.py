"""Several environments at once, each in this process or in a worker of its own, as LeRobot's evaluation wants them.

An environment whose episode has ended stands still, at no cost, until the next reset. One that fails (a diverged
simulation, a dead worker) loses its episode and says so; the others go on, and it starts afresh at the next reset.
"""

import logging
import os
import subprocess
import sys
from collections.abc import Sequence
from multiprocessing import Pipe
from typing import Any, Protocol, cast

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array
from numpy.typing import NDArray

from lerobot_buds.core import SimulatorError

from .robosuite_env import EnvSettings, Observation, RobosuiteEnv

logger = logging.getLogger(__name__)


class EpisodeVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """Environments of one task, stepped together.

    Args:
        settings: What each environment is made from.
        num_envs: How many.
        in_workers: Runs each in its own process, so that they step at the same time.
    """

    def __init__(self, settings: EnvSettings, num_envs: int, in_workers: bool) -> None:
        self._settings, self._in_workers = settings, in_workers
        self._template = RobosuiteEnv(settings)  # never reset: it answers for spaces and attributes only
        self.num_envs = num_envs
        self.metadata = RobosuiteEnv.metadata | {"autoreset_mode": AutoresetMode.DISABLED}
        self.render_mode = "rgb_array"
        self.single_observation_space = self._template.observation_space
        self.single_action_space = self._template.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._slots: list[_Slot | None] = [None] * num_envs
        blank = create_empty_array(self.single_observation_space, n=1, fn=np.zeros)
        self._last: list[Observation] = [_first(blank)] * num_envs
        self._ended = np.ones(num_envs, dtype=bool)
        self._truncated = np.zeros(num_envs, dtype=bool)
        self._success = np.zeros(num_envs, dtype=bool)
        self._stages_done = np.zeros((num_envs, len(self._template.stages)), dtype=bool)
        self._errors: list[str] = [""] * num_envs
        self._seeds: list[int | None] = [None] * num_envs

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts a new episode in every environment.

        Args:
            seed: One seed for each, or the first of consecutive ones, or None.
            options: Ignored; LeRobot marks the start of a rollout with it.

        Raises:
            SimulatorError: Not a single environment could start.
        """
        if isinstance(seed, int):
            seed = [seed + i for i in range(self.num_envs)]
        self._seeds = list(seed) if seed is not None else [None] * self.num_envs
        self._ended[:] = self._truncated[:] = self._success[:] = False
        self._stages_done[:] = False
        self._errors = [""] * self.num_envs
        for i in range(self.num_envs):
            self._start(i, "reset", self._seeds[i])
        for i in range(self.num_envs):
            if (answer := self._finish(i)) is not None:
                self._last[i], info = answer
                self._success[i], self._stages_done[i] = info["is_success"], info["stages_done"]
        if all(self._errors):
            raise SimulatorError(self._errors[0])  # nothing runs at all: no bad luck of one episode
        return self._observations(), self._info()

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Advances every environment whose episode goes on; the others repeat their last observation.

        Args:
            actions: ``(num_envs, 4)`` float.
        """
        going = np.flatnonzero(~self._ended)
        rewards = np.zeros(self.num_envs)
        for i in going:
            self._start(i, "step", actions[i])
        for i in going:
            if (answer := self._finish(i)) is not None:
                self._last[i], rewards[i], terminated, self._truncated[i], info = answer
                self._success[i], self._stages_done[i] = info["is_success"], info["stages_done"]
                self._ended[i] = terminated or self._truncated[i]
        return self._observations(), rewards, self._ended & ~self._truncated, self._truncated.copy(), self._info()

    def render(self) -> tuple[NDArray[np.uint8], ...]:
        """Joins both cameras of every environment's last observation, enlarged: ``(2 H, 4 H, 3)`` uint8 each."""
        return tuple(_side_by_side(observation) for observation in self._last)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Answers for an attribute or method that is the same in every environment, or for ``render``."""
        if name == "render":
            return self.render()
        value = getattr(self._template, name)
        return (value(*args, **kwargs) if callable(value) else value,) * self.num_envs

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Reads an attribute of every environment."""
        return self.call(name)

    def close(self, **kwargs: Any) -> None:
        """Ends all environments and their workers; may be called twice, and a later reset starts afresh."""
        for i, slot in enumerate(self._slots):
            if slot is not None:
                slot.close()
            self._slots[i] = None
        self._ended[:] = True

    def _start(self, i: int, command: str, argument: Any) -> None:
        try:
            slot = self._slots[i]
            if slot is None:
                slot = self._slots[i] = (_Worker if self._in_workers else _Local)(self._settings)
            slot.start(command, argument)
        except SimulatorError as error:
            self._lose(i, error)

    def _finish(self, i: int) -> Any:
        slot = self._slots[i]
        if slot is None:
            return None
        try:
            return slot.finish()
        except SimulatorError as error:
            self._lose(i, error)
            return None

    def _lose(self, i: int, error: SimulatorError) -> None:
        if (slot := self._slots[i]) is not None:
            slot.close()
        self._slots[i] = None
        self._ended[i] = self._truncated[i] = True
        self._errors[i] = str(error)
        logger.error(
            "Environment %d lost its episode (seed %s) to an error, which LeRobot counts as a failure although the "
            "policy is not to blame: %s",
            i,
            self._seeds[i],
            error,
        )

    def _observations(self) -> Observation:
        space = self.single_observation_space
        out = cast(Observation, create_empty_array(space, n=self.num_envs))
        return cast(Observation, concatenate(space, self._last, out))

    def _info(self) -> dict[str, Any]:
        return {
            "is_success": self._success.copy(),
            "stages_done": self._stages_done.copy(),
            "error": np.array(self._errors, dtype=object),
        }


class _Slot(Protocol):
    """Where one environment lives: a command is started, later its answer is fetched."""

    def start(self, command: str, argument: Any) -> None: ...

    def finish(self) -> Any: ...

    def close(self) -> None: ...


class _Local:
    """An environment in this process."""

    def __init__(self, settings: EnvSettings) -> None:
        self.env = RobosuiteEnv(settings)
        self._pending: tuple[str, Any] = ("", None)

    def start(self, command: str, argument: Any) -> None:
        self._pending = (command, argument)

    def finish(self) -> Any:
        return run_command(self.env, *self._pending)

    def close(self) -> None:
        self.env.close()


class _Worker:
    """An environment in a process of its own, which imports nothing but the simulator."""

    def __init__(self, settings: EnvSettings) -> None:
        self._connection, theirs = Pipe()
        path = os.pathsep.join(p for p in sys.path if p)
        # Not a multiprocessing.Process: that would import LeRobot's console script anew in every worker.
        self.process = subprocess.Popen(
            [sys.executable, "-m", "lerobot_buds.envs.worker", str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            env=os.environ | {"PYTHONPATH": path},
        )
        theirs.close()
        self.start("open", settings)

    def start(self, command: str, argument: Any) -> None:
        try:
            self._connection.send((command, argument))
        except (BrokenPipeError, ConnectionResetError) as error:
            raise self._death() from error

    def finish(self) -> Any:
        try:
            failure, answer = self._connection.recv()
        except (EOFError, ConnectionResetError) as error:
            raise self._death() from error
        if failure:
            raise SimulatorError(failure)
        return answer

    def close(self) -> None:
        self._connection.close()  # the worker ends when its pipe does
        try:
            self.process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def _death(self) -> SimulatorError:
        return SimulatorError(f"The environment's process died (exit status {self.process.wait()}).")


def run_command(env: RobosuiteEnv, command: str, argument: Any) -> Any:
    """Runs ``reset`` (argument: the seed) or ``step`` (argument: the action) on an environment."""
    return env.reset(seed=argument) if command == "reset" else env.step(argument)


def _side_by_side(observation: Observation) -> NDArray[np.uint8]:
    joined: NDArray[np.uint8] = np.concatenate(list(observation["pixels"].values()), axis=1)
    return joined.repeat(2, axis=0).repeat(2, axis=1)


def _first(batch: Any) -> Any:
    return {k: _first(v) for k, v in batch.items()} if isinstance(batch, dict) else batch[0]
