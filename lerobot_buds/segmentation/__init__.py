"""Skill discovery: hierarchical task structure, temporal segments, skill partition, and the labels in a dataset.

Importing this folder loads nothing; a name loads its module, of which those with settings need not even scikit-learn.
Torch, LeRobot and matplotlib are loaded by the functions that need them.
"""

from typing import TYPE_CHECKING

from lerobot_buds.core import on_demand

if TYPE_CHECKING:
    from .card import card_kwargs, write_card
    from .companion import COMPANION_FILES, join_companion, write_companion
    from .curve import draw_silhouettes
    from .discovery import SkillDiscovery
    from .exemplars import read_library, write_library
    from .library import SkillLibrary
    from .model import REPRESENTATION_DIR, DiscoveredSkills, SkillModel, discover_skills, given_skills
    from .naming import automatic_names, names_of, read_names, write_names
    from .record import SegmentationRecord, SourceDescription, check_labels, load_labels
    from .settings import PRESETS, DiscoveryConfig, preset
    from .share import share_dataset, share_labels
    from .subtasks import write_subtasks
    from .temporal import temporal_segments
    from .timeline import draw_timeline
    from .tree import TaskStructure, build_tree
    from .write import check_target, write_segmented_dataset
else:
    __getattr__ = on_demand(__name__)

__all__ = [
    "COMPANION_FILES",
    "PRESETS",
    "REPRESENTATION_DIR",
    "DiscoveredSkills",
    "DiscoveryConfig",
    "SegmentationRecord",
    "SkillDiscovery",
    "SkillLibrary",
    "SkillModel",
    "SourceDescription",
    "TaskStructure",
    "automatic_names",
    "build_tree",
    "card_kwargs",
    "check_labels",
    "check_target",
    "discover_skills",
    "draw_silhouettes",
    "draw_timeline",
    "given_skills",
    "join_companion",
    "load_labels",
    "names_of",
    "preset",
    "read_library",
    "read_names",
    "share_dataset",
    "share_labels",
    "temporal_segments",
    "write_card",
    "write_companion",
    "write_library",
    "write_names",
    "write_segmented_dataset",
    "write_subtasks",
]
