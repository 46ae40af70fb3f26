"""Which episodes of a recording were kept, from what LeRobot announces, and the record that training checks.

How many episodes are saved stands in the dataset when the next one begins. An episode that was recorded again is not
among them. The record is written after every saved episode, atomically.
"""

import logging
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from lerobot_buds.core import COLLECTION_FILE, DatasetError, read_json, same_rate, write_json
from lerobot_buds.data import LocalDataset, read_collection
from lerobot_buds.data.collection import RECORD_VERSION
from lerobot_buds.envs import EnvSettings, tasks_named

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Episode:
    """One episode of the dataset.

    Attributes:
        seed: Seed of its scene; None where it was recorded without this record.
        succeeded: Whether the goal was reached and held to the end; None where that is not known.
        demonstrator: ``teleoperated``, ``policy``, or ``correction`` (a person who took over from a policy).
    """

    seed: int | None
    succeeded: bool | None
    demonstrator: str | None


@dataclass
class Session:
    """The episodes that were kept so far, and the one that may be.

    Attributes:
        root: The dataset's folder; None where the robot was not told, and nothing is written.
        settings: The environment.
        kept: Episodes of the dataset, first to last; of earlier recordings, too.
    """

    root: Path | None
    settings: EnvSettings
    kept: list[Episode] = field(default_factory=list)
    _open: Episode | None = None
    _counts: bool = False
    _text_was_read: bool = False

    @classmethod
    def begin(cls, root: Path | None, settings: EnvSettings) -> "Session":
        """Begins a recording, or goes on with one that its dataset has a record of.

        Raises:
            DatasetError: The record is damaged, or of another task or drawn otherwise.
        """
        session = cls(root, settings)
        record = {} if root is None else read_collection(root)
        if not record:
            return session
        ours = {"task": settings.task, "render_profile": settings.render_profile, "image_size": settings.image_size}
        (former,) = record["tasks"] if len(record.get("tasks", [])) == 1 else ({},)
        found = {"task": former.get("name"), **{key: record.get(key) for key in ("render_profile", "image_size")}}
        if found != ours or "succeeded" not in former:
            raise DatasetError(
                f"{root} was recorded with {found}, not with {ours} by this robot. Give the same settings, or record "
                "into another dataset."
            )
        rows = zip(former["episode_seeds"], former["succeeded"], former["demonstrators"], strict=True)
        session.kept = [Episode(*row) for row in rows]
        return session

    @property
    def next_seed(self) -> int:
        """The first seed that no kept episode has, nor a lesser one than theirs."""
        return 1 + max((episode.seed for episode in self.kept if episode.seed is not None), default=-1)

    def start(self, saved: int | None, fps: float) -> None:
        """Begins to count, before the first episode.

        Args:
            saved: How many episodes LeRobot says that its dataset has; None where it does not say.
            fps: Control steps per second of the simulation.

        Raises:
            DatasetError: There is no dataset in the folder, it is another one, or has another rate.
        """
        if self._counts:
            return
        if self.root is None:
            logger.warning(
                "How this dataset comes about is not written into it: say where it is by --robot.dataset_root."
            )
            self._counts = True
            return
        if not (self.root / "meta/info.json").exists():
            raise DatasetError(f"There is no dataset in {self.root}: give --robot.dataset_root as --dataset.root.")
        dataset = LocalDataset(self.root)
        if saved not in (None, self._saved()):
            raise DatasetError(f"{self.root} is not recorded into: give --robot.dataset_root as --dataset.root.")
        if not same_rate(dataset.fps, fps):
            raise DatasetError(
                f"{self.root} has {dataset.fps:g} frames per second, the simulation {fps:g}: record with "
                f"--dataset.fps={fps:g} (and --fps={fps:g} in a rollout)."
            )
        self._counts = True
        self._align()

    def ended(self, episode: Episode) -> None:
        """Tells of an episode that may be kept; what is told last is what counts."""
        self._open = episode

    def settle(self) -> Episode | None:
        """Keeps the open episode if the dataset has one more, else drops it; writes the record.

        Returns:
            The episode, if it was kept.

        Raises:
            StorageError: The record cannot be written.
        """
        if not self._counts or self.root is None:
            return None
        kept, self._open = self._open, None
        if kept is not None and self._saved() == len(self.kept) + 1:
            self.kept.append(kept)
            self._warn_of_another_text(self.root)
        else:
            kept = None
        self._align()
        if self.kept:
            self.write(self.root)
        return kept

    def write(self, root: Path) -> None:
        """Writes the record of the kept episodes.

        Args:
            root: Folder of their dataset.

        Raises:
            StorageError: It cannot be written.
        """
        write_json(root / COLLECTION_FILE, self._record())

    def _saved(self) -> int:
        assert self.root is not None
        return int(read_json(self.root / "meta/info.json")["total_episodes"])

    def _warn_of_another_text(self, root: Path) -> None:
        """Says so, once, if the episodes are told to do something in other words than the task's own."""
        (task,) = tasks_named(self.settings.task)
        texts = pq.read_table(root / "meta/tasks.parquet").to_pandas().index
        others = sorted(set(texts) - {task.description})
        if others and not self._text_was_read:
            logger.warning(
                "The task is called %r here, and %r in the environment. A policy that is trained on this knows the "
                "former alone, and lerobot-eval names the latter: record with --dataset.single_task=%r.",
                others[0],
                task.description,
                task.description,
            )
        self._text_was_read = True

    def _align(self) -> None:
        """Makes the list as long as the dataset; of what was recorded without us nothing is known."""
        unknown = self._saved() - len(self.kept)
        if unknown:
            logger.warning(
                "%s has %d episodes, and its record %d: seeds and success of some are not known.",
                self.root,
                self._saved(),
                len(self.kept),
            )
        self.kept = self.kept[: self._saved()] + [Episode(None, None, None)] * max(0, unknown)

    def _record(self) -> dict[str, Any]:
        rows = [asdict(episode) for episode in self.kept]
        (task,) = tasks_named(self.settings.task)
        names = sorted({row["demonstrator"] for row in rows if row["demonstrator"]})
        return {
            "version": RECORD_VERSION,
            "demonstrator": ", ".join(names) or "unknown",
            "tasks": [
                {
                    "name": task.name,
                    "description": task.description,
                    "episode_seeds": [row["seed"] for row in rows],
                    "succeeded": [row["succeeded"] for row in rows],
                    "demonstrators": [row["demonstrator"] for row in rows],
                }
            ],
            "render_profile": self.settings.render_profile,
            "image_size": self.settings.image_size,
            "versions": {name: version(name) for name in ("lerobot_policy_buds", "lerobot", "robosuite", "mujoco")},
        }
