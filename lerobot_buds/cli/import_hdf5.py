"""``lerobot-buds-import``: imports HDF5 demonstrations of robomimic or of the BUDS release into a LeRobotDataset."""

from dataclasses import dataclass
from pathlib import Path

import draccus

from lerobot_buds.demos.hdf5_layouts import Source
from lerobot_buds.demos.importing import Import, Imported, import_demonstrations

from .running import dataset_root, run


@dataclass
class ImportConfig:
    """Settings of an import."""

    source: str
    """The HDF5 file; it is only read."""

    repo_id: str
    """The dataset's name, for example ``me/tool_use``."""

    task: str
    """What the demonstrations do, in words, for example ``"hang up the tool"``."""

    fps: int
    """The control rate at which they were recorded (frames per second); robosuite's default and the release's is 20."""

    root: str | None = None
    """The dataset's folder; None for LeRobot's own place for `repo_id`."""

    layout: str | None = None
    """``robomimic`` or ``buds``; None to tell by the names in the file."""

    cameras: dict[str, str] | None = None
    """Camera -> image array, as in ``{front: frontview_image}``; None for the layout's agentview and eye_in_hand."""

    state: list[str] | None = None
    """Vector arrays that make up the state; None for the layout's joints, fingers and hand position."""

    alignment: str = "lerobot"
    """``lerobot``: an observation with the action that followed it; ``released``: as the BUDS release paired them."""

    flip: bool = False
    """Turns images upside down: for files that keep robosuite's raw images, whose bottom row comes first."""

    filter_key: str | None = None
    """Imports only these: a key of robomimic's ``mask``, or a task number of the release's multi-task file."""

    video: bool = True
    """Stores the cameras as video, else as images."""


def import_hdf5(config: ImportConfig) -> Imported:
    """Imports the demonstrations that the settings ask for."""
    return import_demonstrations(
        Import(
            source=Source(
                path=Path(config.source),
                layout=config.layout,
                cameras=config.cameras,
                state=config.state,
                alignment=config.alignment,
                flip=config.flip,
                filter_key=config.filter_key,
            ),
            repo_id=config.repo_id,
            root=dataset_root(config.repo_id, config.root),
            task=config.task,
            fps=config.fps,
            video=config.video,
        )
    )


def main() -> None:
    """Entry point of the console script."""
    config = draccus.parse(ImportConfig)
    imported = run(lambda: import_hdf5(config))
    print(f"{imported.episodes} demonstrations, {imported.frames} frames")
