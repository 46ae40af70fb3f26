"""LeRobotDatasets on this machine: reading, checking, decoding, caching, writing and moving them."""

from .checks import check_demonstrations, dimension_names, require_finite, require_videos, require_whole
from .collection import read_collection
from .frames import cached_frames, frame_size, frames_key
from .hub import download, upload
from .tables import DatasetFiles, FrameTable, read_table
from .writing import make_once, only_writer

__all__ = [
    "DatasetFiles",
    "FrameTable",
    "cached_frames",
    "check_demonstrations",
    "dimension_names",
    "download",
    "frame_size",
    "frames_key",
    "make_once",
    "only_writer",
    "read_collection",
    "read_table",
    "require_finite",
    "require_videos",
    "require_whole",
    "upload",
]
