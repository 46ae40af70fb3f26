"""Demonstrations: scripted demonstrators, recording, reading and checking LeRobotDatasets."""

from .frames import cached_frames, frames_key
from .tables import DatasetFiles, FrameTable, read_table

__all__ = ["DatasetFiles", "FrameTable", "cached_frames", "frames_key", "read_table"]
