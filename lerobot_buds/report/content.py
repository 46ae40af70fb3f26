"""What a report is made from: labels, stages, tasks and trees of the chosen demonstrations of a segmented dataset."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from lerobot_buds.core import TRUE_STAGE, CheckpointError, FloatArray, IntArray, SegmentationError
from lerobot_buds.data import LocalDataset, read_collection, true_stages
from lerobot_buds.segmentation import SegmentationRecord, SkillModel, TaskStructure, load_labels, names_of
from lerobot_buds.segmentation.settings import TREE

logger = logging.getLogger(__name__)

SIDE = 96
"""Side at which frames are read where no representation tells one (pixels)."""


@dataclass(frozen=True)
class Structure:
    """How one demonstration was cut.

    Attributes:
        tree: Its hierarchical task structure; None where something else than a tree cut it.
        segments: ``(S, 2)`` its temporal segments.
    """

    tree: TaskStructure | None
    segments: IntArray


@dataclass(frozen=True)
class Content:
    """The chosen demonstrations of a segmented dataset; sequences are in their order.

    Attributes:
        dataset: The dataset.
        record: Its segmentation record.
        collection: The record of how it was recorded or imported; empty where there is none.
        numbers: Numbers of the episodes.
        starts: Absolute index of the first frame of each.
        labels: ``(T,)`` skill of every frame.
        tasks: Tasks of each.
        stages: ``(T,)`` true stage of every frame; None where these are not known.
        structures: How each was cut; None where the dataset lacks what made its latents.
        side: Side of the squares in which the frame store holds its frames already (pixels).
        names: Names of the skills; None where it carries none.
        latents: ``(T, D)`` latents of each; None where the dataset lacks what made them.
    """

    dataset: LocalDataset
    record: SegmentationRecord
    collection: Mapping[str, Any]
    numbers: list[int]
    starts: list[int]
    labels: list[IntArray]
    tasks: list[tuple[str, ...]]
    stages: list[IntArray] | None
    structures: list[Structure] | None
    side: int
    names: tuple[str, ...] | None = None
    latents: list[FloatArray] | None = None

    @classmethod
    def read(cls, dataset: LocalDataset) -> Self:
        """Reads a segmented dataset; latents are computed where the frame store does not hold them.

        Raises:
            DatasetError: It is damaged or incomplete.
            SegmentationError: It is not segmented, or its labels are out of step with its record.
        """
        record, _, _ = load_labels(dataset.root)
        numbers = [int(episode["episode_index"]) for episode in dataset.episodes]
        labels = record.labels
        try:
            model = SkillModel.from_pretrained(dataset.root)
            latents, structures = _structures(dataset, model)
            side = model.representation.config.side
        except (SegmentationError, CheckpointError) as error:
            logger.warning("The report shows no trees: %s", error)
            latents, structures, side = None, None, SIDE
        return cls(
            dataset,
            record,
            read_collection(dataset.root),
            numbers,
            [int(episode["dataset_from_index"]) for episode in dataset.episodes],
            [labels[number] for number in numbers],
            [tuple(map(str, episode.get("tasks") or ())) for episode in dataset.episodes],
            true_stages(dataset) if TRUE_STAGE in dataset.features else None,
            structures,
            side,
            names_of(dataset.root, record.n_skills),
            latents,
        )

    @property
    def stage_names(self) -> dict[int, str]:
        """Stages that occur, ascending, by the names that the demonstrator gave them, else by their numbers."""
        if self.stages is None:
            return {}
        found: list[int] = np.unique(np.concatenate(self.stages)).tolist()
        named = self.collection.get("stages")
        names = list(map(str, named)) if isinstance(named, list) else []
        return {k: names[k].replace("_", " ") if 0 <= k < len(names) else f"stage {k}" for k in found}


def _structures(dataset: LocalDataset, model: SkillModel) -> tuple[list[FloatArray], list[Structure]]:
    """Encodes and cuts the demonstrations again; where that depends on all of them, a choice may differ slightly."""
    from lerobot_buds.representation import encode_dataset

    latents = encode_dataset(dataset, model.representation)
    discovery = model.config.build(dataset.fps)
    trees = discovery.trees(latents) if model.config.cut == TREE else {}
    return latents, [Structure(trees.get(place), segments) for place, segments in enumerate(discovery.cut(latents))]
