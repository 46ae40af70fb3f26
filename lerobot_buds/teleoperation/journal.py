"""What it takes to do a recording again: seed and actions of every saved episode, in a folder beside the dataset.

LeRobot's tables get their last bytes when a recording is finished. A process that is killed before leaves tables that
nothing reads, of all its episodes. The simulation is deterministic, so the journal brings them back. It is written
episode by episode, each atomically, and removed once the dataset is whole.
"""

import logging
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_buds.core import (
    ACTION,
    IMAGE_PREFIX,
    STATE,
    DatasetError,
    SimulatorError,
    read_json,
    staged_directory,
    write_json,
)
from lerobot_buds.data.joining import join_parts
from lerobot_buds.data.parts import write_part
from lerobot_buds.data.writing import require_encodable
from lerobot_buds.demos.recording import features_of
from lerobot_buds.envs import ACTION_NAMES, CAMERAS, FPS, STATE_NAMES, EnvSettings, tasks_named

from .scene import Scene
from .session import Episode, Session

logger = logging.getLogger(__name__)

SETTINGS_FILE = "settings.json"


_REMEDY = (
    "Its episodes can be done again, by lerobot-buds-collect --repo_id=... --root=... --journal={journal}; then remove "
    "that folder."
)


def journal_of(root: Path) -> Path:
    """Tells where the journal of a dataset is: beside it.

    Args:
        root: The dataset's folder.
    """
    return root.with_name(f".{root.name}.journal")


@dataclass
class Journal:
    """The journal of a recording.

    Attributes:
        root: The dataset's folder; None where the robot was not told: then nothing is written.
        settings: The environment.
    """

    root: Path | None
    settings: EnvSettings
    _actions: list[NDArray[np.float32]] = field(default_factory=list)

    def require_none(self) -> None:
        """Refuses to mix the episodes with those of a recording that was killed.

        Raises:
            DatasetError: There is a journal already.
        """
        if self.root is not None and (folder := journal_of(self.root)).exists():
            raise DatasetError(f"{folder} is of a recording that was killed. {_REMEDY.format(journal=folder)}")

    def begin_episode(self) -> None:
        """Begins an episode: what was told since the last one was saved is forgotten."""
        self._actions = []

    def add(self, action: NDArray[np.float32]) -> None:
        """Remembers an action, (4,) float32 as it was told, that was executed in the episode."""
        self._actions.append(action)

    def keep(self, number: int, episode: Episode) -> None:
        """Writes the episode that was saved.

        Args:
            number: Its number in the dataset.
            episode: What is known of it.

        Raises:
            StorageError: The disk is full, or the folder cannot be written.
        """
        if self.root is None or not self._actions:
            return
        folder = journal_of(self.root)
        folder.mkdir(exist_ok=True)
        write_json(folder / SETTINGS_FILE, asdict(self.settings))
        actions = [action.tolist() for action in self._actions]
        write_json(folder / f"{number:06d}.json", {**asdict(episode), "actions": actions})

    def close(self) -> None:
        """Removes the journal if the dataset's tables can be read, and else says how to do its episodes again."""
        if self.root is None or not (folder := journal_of(self.root)).is_dir():
            return
        if _is_whole(self.root):
            shutil.rmtree(folder)
        else:
            logger.warning("%s cannot be read. %s", self.root, _REMEDY.format(journal=folder))


def restore(journal: Path, repo_id: str, root: Path, video: bool, text: str | None = None) -> Session:
    """Makes a dataset of a journal: executes its actions again, episode by episode.

    Args:
        journal: The journal's folder.
        repo_id: The dataset's name.
        root: The dataset's folder, which must not exist.
        video: Stores the cameras as video, else as images.
        text: What the episodes do, in words; the task's own description where None.

    Returns:
        What the dataset holds.

    Raises:
        DatasetError: The journal is empty or damaged, or the dataset exists.
        SimulatorError: The simulator is missing or failed, or an episode came out otherwise than it was recorded.
        StorageError: The disk is full, or cannot be written.
    """
    if root.exists():
        raise DatasetError(f"{root} exists already. Remove it or choose another --root.")
    try:
        settings = EnvSettings(**read_json(journal / SETTINGS_FILE))
        stored = [read_json(path) for path in sorted(journal.glob("[0-9]*.json"))]
        rows = [_row(episode) for episode in stored]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise DatasetError(f"{journal} is no journal of a recording on the simulated robot ({error}).") from error
    if not rows:
        raise DatasetError(f"{journal} has no saved episode.")
    session = Session(root, settings, [episode for episode, _ in rows])
    with staged_directory(root) as staging:
        parts = _parts(staging / "parts", repo_id, settings, rows, video, text)
        join_parts(parts, repo_id, staging / "joined")
        shutil.rmtree(staging / "parts")
        for entry in (staging / "joined").iterdir():
            entry.rename(staging / entry.name)
        (staging / "joined").rmdir()
        session.write(staging)
    return session


def _row(stored: dict[str, Any]) -> tuple[Episode, NDArray[np.float32]]:
    """Takes an episode of the journal apart: what is known of it, and its actions, (T, 4) float32.

    Raises:
        KeyError, TypeError, ValueError: Something is missing in it, or is not what it should be.
    """
    actions = np.array(stored["actions"], dtype=np.float32)
    if actions.ndim != 2 or actions.shape[1] != len(ACTION_NAMES):
        raise ValueError(f"actions of shape {actions.shape}, not (T, {len(ACTION_NAMES)})")
    if not isinstance(stored["seed"], int):
        raise ValueError(f"seed {stored['seed']!r}")
    return Episode(*(stored[key] for key in ("seed", "succeeded", "demonstrator"))), actions


def _is_whole(root: Path) -> bool:
    """Tells whether the tables of a dataset were finished, and tell of all of its episodes."""
    try:
        data = [pq.read_metadata(table).num_rows for table in root.glob("data/*/*.parquet")]
        episodes = [pq.read_metadata(table).num_rows for table in root.glob("meta/episodes/*/*.parquet")]
    except (OSError, ValueError):  # pyarrow's errors are either
        return False
    info = read_json(root / "meta/info.json")
    return (sum(data), sum(episodes)) == (info["total_frames"], info["total_episodes"])


def _parts(
    folder: Path,
    repo_id: str,
    settings: EnvSettings,
    rows: list[tuple[Episode, NDArray[np.float32]]],
    video: bool,
    text: str | None,
) -> Iterator[Path]:
    """Executes episode after episode and yields each as a dataset of its own."""
    features = features_of(settings.image_size, video)
    require_encodable(features)
    (task,) = tasks_named(settings.task)
    scene = Scene(settings, None)
    try:
        for number, (episode, actions) in enumerate(rows):
            assert episode.seed is not None
            scene.begin(episode.seed)
            columns = {ACTION: actions}
            shown = []
            for action in actions:
                shown.append(scene.shown)
                scene.act(action)
            if scene.succeeded != episode.succeeded:
                raise SimulatorError(
                    f"Episode {number} (seed {episode.seed}) came out otherwise than it was recorded: this simulator "
                    "moves differently. Do it again with the MuJoCo and robosuite that it was recorded with."
                )
            columns[STATE] = np.array([[each[name] for name in STATE_NAMES] for each in shown], dtype=np.float32)
            columns |= {IMAGE_PREFIX + camera: np.stack([each[camera] for each in shown]) for camera in CAMERAS}
            part = folder / f"{number:06d}"
            write_part(part, repo_id, FPS, features, columns, text or task.description, robot_type="robosuite_sim")
            yield part
    finally:
        scene.close()
