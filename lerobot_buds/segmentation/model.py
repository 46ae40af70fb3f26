"""What it takes to label demonstrations: a representation, settings, and a library of skills. Kept in ``meta/buds``.

torch and LeRobot are imported on use, so that importing this module stays cheap.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

from lerobot_buds.core import (
    EXEMPLARS_FILE,
    NAMES_FILE,
    RECORD_DIR,
    SEGMENTATION_FILE,
    FloatArray,
    IntArray,
    SegmentationError,
    same_rate,
)

from .exemplars import read_library, write_library
from .library import SkillLibrary
from .naming import names_of
from .partition import spans_of
from .record import SegmentationRecord
from .settings import DiscoveryConfig

if TYPE_CHECKING:
    from lerobot_buds.data import AnyDataset
    from lerobot_buds.representation import Representation, RepresentationConfig

REPRESENTATION_DIR = f"{RECORD_DIR}/representation"


@dataclass(frozen=True)
class SkillModel:
    """Labels demonstrations with known skills.

    Attributes:
        representation: Makes a latent of every frame.
        config: Settings of skill discovery, with the durations that were taken from the demonstrations.
        library: Exemplars of the skills.
        lineage: The segmentations that gave the skills their numbers, see `SegmentationRecord.lineage`.
        fps: Rate of the demonstrations that they were found in (frames per second).
        names: Names of the skills, as far as these are known.
        commit: The commit that they were fetched from; None where they were not fetched.
    """

    representation: "Representation"
    config: DiscoveryConfig
    library: SkillLibrary
    lineage: tuple[str, ...] = ()
    fps: float | None = None
    names: tuple[str, ...] = ()
    commit: str | None = None

    def label(self, dataset: "AnyDataset", grow: bool = False) -> "DiscoveredSkills":
        """Labels a dataset with the skills of the library.

        Args:
            dataset: What stands for the dataset; its chosen episodes must be whole on this machine, with the cameras
                and the state that the representation was trained on.
            grow: Opens new skills for what is far from all known ones.

        Raises:
            DatasetError: The dataset is damaged or incomplete.
            CheckpointError: Its cameras or its state are not those of the representation.
            SegmentationError: It has no frames, or another rate than the demonstrations of the skills.
        """
        from lerobot_buds.data import LocalDataset

        local = LocalDataset.of(dataset)
        if self.fps is not None and not same_rate(self.fps, local.fps):
            raise SegmentationError(
                f"The skills were found at {self.fps:g} frames a second, {local.root} has {local.fps:g}: no policy "
                "could use both. Take a library of this rate, or segment the dataset without one."
            )
        latents, fps = _encoded(local, self.representation)
        discovery = self.config.build(fps)
        bounds = discovery.cut(latents)
        min_length = discovery.durations_.min_skill_length
        labels = self.library.label(latents, bounds, grow=grow, min_length=min_length)
        library = self.library.with_demonstrations(latents, bounds, labels)
        return DiscoveredSkills(labels, latents, replace(self, library=library))

    def save(self, root: Path) -> None:
        """Writes representation and exemplars into a segmented dataset; the settings are in its record.

        Args:
            root: Folder of the dataset.
        """
        self.representation.save(root / REPRESENTATION_DIR)
        write_library(root, self.library)

    @classmethod
    def from_pretrained(cls, name: str | Path, revision: str | None = None) -> Self:
        """Reads the skills of a segmented dataset, of which no more than these are fetched.

        Args:
            name: Folder of the dataset, or its repository on the Hub.
            revision: Branch, tag or commit of the repository; the main branch where None.

        Raises:
            SegmentationError: The dataset holds no skills to label others with.
            CheckpointError: The repository cannot be had, or the representation in it is damaged.
        """
        from lerobot_buds.data import commit_of, download
        from lerobot_buds.representation import REPRESENTATION_FILES, Representation

        root = Path(name)
        if not root.is_dir():
            files = [f"{REPRESENTATION_DIR}/{file}" for file in REPRESENTATION_FILES]
            files += [SEGMENTATION_FILE, EXEMPLARS_FILE, NAMES_FILE]
            root = download(str(name), files, revision, repo_type="dataset")
        record = SegmentationRecord.read(root)
        try:
            config = DiscoveryConfig(**record.parameters)
        except TypeError as error:
            raise SegmentationError(
                f"{root / SEGMENTATION_FILE} has settings that this version does not know ({error}); segment the "
                "dataset that it was made from into another --output_root."
            ) from error
        representation = Representation.load(root / REPRESENTATION_DIR)
        names = names_of(root, record.n_skills) or ()
        library, rate, commit = read_library(root), record.source.fps, commit_of(root)
        return cls(representation, config, library, record.lineage, rate, names, commit)


@dataclass(frozen=True)
class DiscoveredSkills:
    """The skills of a dataset.

    Attributes:
        labels: ``(T,)`` int64 skill of every frame, per demonstration.
        latents: ``(T, D)`` float64 latents, per demonstration.
        model: Labels further datasets with these skills.
        scores: Where the number of skills was chosen, how well each number of clusters parts the segments; else empty.
        stability: How much of the labels holds when the demonstrations differ slightly, see `stability.stability`; None
            where a library labelled them, or the labels were there before.
    """

    labels: list[IntArray]
    latents: list[FloatArray]
    model: SkillModel
    scores: dict[int, float] = field(default_factory=dict)
    stability: float | None = None

    @property
    def n_skills(self) -> int:
        """Number of skills K; not all of a library's need to occur."""
        return self.model.library.n_skills


def discover_skills(
    dataset: "AnyDataset",
    representation: "Representation | RepresentationConfig | None" = None,
    config: DiscoveryConfig | None = None,
    work_dir: Path | None = None,
) -> DiscoveredSkills:
    """Discovers the skills of a dataset.

    Args:
        dataset: A LeRobotDataset, its folder, or a `LocalDataset`; its chosen episodes must be whole on this machine,
            and are only read.
        representation: A trained representation, or settings of the one to train; default ones where None.
        config: Settings of skill discovery; default ones where None.
        work_dir: Keeps the representation that is trained, so that a second call does not train it again;
            ``outputs/segment/`` and the dataset's folder name where None.

    Raises:
        DatasetError: The dataset is damaged or incomplete.
        SegmentationError: It cannot be segmented as asked.
        ConfigError: A setting cannot work.
        CheckpointError: The representation does not fit the dataset.
    """
    representation, config = _trained(dataset, representation, work_dir), config or DiscoveryConfig()
    latents, fps = _encoded(dataset, representation)
    found = config.build(fps).fit(latents)
    library = SkillLibrary.of(
        latents, found.temporal_segments_, found.labels_, found.n_skills_, num_keyframes=config.num_keyframes
    )
    model = SkillModel(representation, config.settled(found, fps), library, fps=fps)
    return DiscoveredSkills(found.labels_, latents, model, found.scores_, found.check_stability(latents))


def given_skills(
    dataset: "AnyDataset",
    labels: Sequence[IntArray],
    n_skills: int,
    representation: "Representation | RepresentationConfig | None" = None,
    config: DiscoveryConfig | None = None,
    work_dir: Path | None = None,
) -> DiscoveredSkills:
    """Makes skills of labels that were there before; the representation is needed to label others, and for subgoals.

    Args:
        dataset: As for `discover_skills`, as are the last three and the errors.
        labels: ``(T,)`` int64 label of every frame, per demonstration, in ``[0, n_skills)``.
        n_skills: Number of skills K.
        representation: A trained representation, or settings of the one to train.
        config: Settings by which further demonstrations are cut.
        work_dir: Keeps the representation that is trained.

    Raises:
        SegmentationError: The labels are not of these demonstrations.
    """
    representation, config = _trained(dataset, representation, work_dir), config or DiscoveryConfig()
    latents, fps = _encoded(dataset, representation)
    if [len(episode) for episode in labels] != [len(episode) for episode in latents]:
        raise SegmentationError("The labels have other lengths than the demonstrations: read them from this dataset.")
    bounds = [spans_of(episode) for episode in labels]
    library = SkillLibrary.of(latents, bounds, labels, n_skills, num_keyframes=config.num_keyframes)
    cutter = config.build(fps)
    cutter.cut(latents)  # settles the durations by which further demonstrations will be cut
    return DiscoveredSkills(
        list(labels), latents, SkillModel(representation, config.settled(cutter, fps), library, fps=fps)
    )


def _trained(
    dataset: "AnyDataset", representation: "Representation | RepresentationConfig | None", work_dir: Path | None
) -> "Representation":
    from lerobot_buds.data import LocalDataset
    from lerobot_buds.representation import Representation, RepresentationConfig, train_representation

    if isinstance(representation, Representation):
        return representation
    local = LocalDataset.of(dataset)
    folder = (work_dir or Path("outputs/segment") / local.root.name) / "representation"
    return train_representation(local, representation or RepresentationConfig(), folder)


def _encoded(dataset: "AnyDataset", representation: "Representation") -> tuple[list[FloatArray], float]:
    from lerobot_buds.data import LocalDataset
    from lerobot_buds.representation import encode_dataset

    return encode_dataset(dataset, representation), LocalDataset.of(dataset).fps
