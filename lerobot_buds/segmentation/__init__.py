"""Skill discovery: hierarchical task structure, temporal segments, skill partition."""

from .discovery import DiscoveryConfig, SkillDiscovery
from .temporal import temporal_segments
from .tree import TaskStructure, build_tree

__all__ = ["DiscoveryConfig", "SkillDiscovery", "TaskStructure", "build_tree", "temporal_segments"]
