"""What is read and how: the settings of a source, and what any opened source offers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray

ALIGNMENTS = ("lerobot", "released")
ORIENTATIONS = ("stored", "flipped", "rotated")


@dataclass(frozen=True)
class Source:
    """Which demonstrations of which file are read, and how.

    Attributes:
        path: The HDF5 file, or a folder whose files become one dataset.
        layout: A key of `LAYOUTS`; None to tell by the file.
        cameras: Camera -> image array, or camera of the simulated scene; none where empty, the layout's own where None.
        state: Vector arrays that make up the state, in this order; none where empty, the layout's own where None.
        alignment: ``lerobot`` pairs an observation with the action that followed it; ``released`` pairs rows as they
            are stored, only for comparisons with results that were learned from those.
        orientation: How images are turned: ``stored`` leaves them, ``flipped`` turns them upside down, ``rotated`` by
            180 degrees. None for what the layout and the file tell.
        filter_key: Reads only these demonstrations: a name in robomimic's ``mask``, or a task number of the release's
            multi-task file (an attribute of ``data/task``). None for all.
        resample: Takes rows of a simulator's states at this rate (frames per second), the nearest ones in time; None
            for all rows, which must be equally far apart.
        uneven: Takes all rows although they are not equally far apart.
        image_size: Height and width of images that are drawn here (pixels).
        render_profile: What is drawn, a key of `PROFILES`.
        assets: Folder of the meshes and textures of a simulated scene; the installed robosuite's where None.
    """

    path: Path
    layout: str | None = None
    cameras: Mapping[str, str] | None = None
    state: Sequence[str] | None = None
    alignment: str = "lerobot"
    orientation: str | None = None
    filter_key: str | None = None
    resample: float | None = None
    uneven: bool = False
    image_size: int = 128
    render_profile: str = "fast"
    assets: Path | None = None


class Demonstrations(Protocol):
    """The demonstrations of a source as LeRobot wants them: a row pairs an observation with the action after it."""

    @property
    def layout(self) -> str:
        """Name of the layout."""
        ...

    @property
    def lengths(self) -> dict[str, int]:
        """Number of frames by the demonstration's name, in the order in which they become episodes."""
        ...

    @property
    def instructions(self) -> dict[str, str]:
        """What demonstrations do, in words, as far as the source says so; by name."""
        ...

    @property
    def environment(self) -> str | None:
        """Name of the simulated task, where the source says it."""
        ...

    @property
    def fps(self) -> float | None:
        """Rows per second, where the source says it."""
        ...

    @property
    def state_names(self) -> list[str]:
        """One name a dimension of the state; none where there is no state."""
        ...

    @property
    def action_names(self) -> list[str]:
        """One name a dimension of the action."""
        ...

    @property
    def image_shapes(self) -> dict[str, tuple[int, ...]]:
        """Image feature -> ``(H, W, 3)``."""
        ...

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the true stages; none where these are not known."""
        ...

    @property
    def facts(self) -> dict[str, Any]:
        """What was told from the source or changed in reading it, as plain data for the record."""
        ...

    def read(self, name: str) -> dict[str, NDArray[Any]]:
        """Reads one demonstration.

        Args:
            name: Its name, a key of `lengths`.

        Returns:
            One row a frame, by the names of the dataset's features: ``action`` and ``observation.state`` float32,
            uint8 RGB images ``(T, H, W, 3)``, top row first, and ``true_stage`` ``(T, 1)`` int64.

        Raises:
            DatasetError: The file is damaged inside.
        """
        ...
