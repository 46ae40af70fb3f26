"""``lerobot-buds-import``: imports HDF5 demonstrations of robomimic, robosuite, LIBERO and others into a dataset."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .running import dataset_root, parse, run

if TYPE_CHECKING:
    from lerobot_buds.demos.importing import Imported


@dataclass
class ImportConfig:
    """Settings of an import."""

    source: Path
    """The HDF5 file, or a folder whose files become one dataset; only read."""

    repo_id: str
    """The dataset's name, for example ``me/tool_use``."""

    task: str | None = None
    """What the demonstrations do, in words, for example ``"hang up the tool"``; None for what the file says."""

    fps: float | None = None
    """The control rate at which they were recorded (frames per second); None for what the file says."""

    overrule: bool = False
    """Lets `task` and `fps` count although the file says otherwise."""

    root: Path | None = None
    """The dataset's folder; None for LeRobot's own place for `repo_id`."""

    layout: str | None = None
    """``robomimic``, ``robocasa``, ``mimicgen``, ``libero``, ``robosuite`` or ``buds``; None to tell by the file."""

    cameras: dict[str, str] | None = None
    """Camera -> image array, as in ``{front: frontview_image}``, or camera of the played scene; ``{}`` for none, None
    for the layout's own."""

    state: list[str] | None = None
    """Vector arrays that make up the state; ``[]`` for none, None for the layout's own."""

    alignment: str = "lerobot"
    """``lerobot``: an observation with the action that followed it; ``released``: as a file pairs them that stores the
    observation after the action."""

    orientation: str | None = None
    """How images are turned: ``stored``, ``flipped`` (upside down) or ``rotated`` (by 180 degrees); None for what the
    file says."""

    filter_key: str | None = None
    """Imports only these: a key of robomimic's ``mask``, or a task number of the release's multi-task file."""

    resample: float | None = None
    """Rows a second to take of a simulator's states, the nearest in time; None for all."""

    uneven: bool = False
    """Takes all states although they are not equally far apart in time."""

    image_size: int = 128
    """Height and width of the cameras of states that are played back (pixels)."""

    render_profile: str = "fast"
    """What is drawn of them: ``fast``, ``fastest`` or ``full``."""

    assets: Path | None = None
    """Folder of the meshes and textures of their scenes (a robosuite's ``models/assets``), searched before those of the
    installed robosuite."""

    video: bool = True
    """Stores the cameras as video, else as images."""


def import_hdf5(config: ImportConfig) -> "Imported":
    """Imports the demonstrations that the settings ask for."""
    from lerobot_buds.demos.hdf5 import Source
    from lerobot_buds.demos.importing import Import, import_demonstrations

    return import_demonstrations(
        Import(
            source=Source(
                path=Path(config.source),
                layout=config.layout,
                cameras=config.cameras,
                state=config.state,
                alignment=config.alignment,
                orientation=config.orientation,
                filter_key=config.filter_key,
                resample=config.resample,
                uneven=config.uneven,
                image_size=config.image_size,
                render_profile=config.render_profile,
                assets=config.assets,
            ),
            repo_id=config.repo_id,
            root=dataset_root(config.repo_id, config.root),
            task=config.task,
            fps=config.fps,
            video=config.video,
            overrule=config.overrule,
        )
    )


def main() -> None:
    """Entry point of the console script."""
    config = parse(ImportConfig)
    imported = run(lambda: import_hdf5(config))
    print(f"{imported.episodes} demonstrations, {imported.frames} frames")
