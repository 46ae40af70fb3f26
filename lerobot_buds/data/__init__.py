"""LeRobotDatasets on this machine: reading, checking, decoding, caching, writing and moving them."""

from .cameras import chosen_cameras, frame_size, used_size
from .cards import render_card
from .checks import check_demonstrations, dimension_names, require_finite, require_videos, require_whole
from .collection import read_collection
from .dataset import AnyDataset, LocalDataset
from .frames import cached_frames, frames_key
from .given import SUBTASK_STYLE, GivenLabels, given_labels, read_annotations
from .hub import download, download_dataset, upload, upload_dataset
from .origin import Origin, commit_of, content_hashes, shown_name
from .scaling import as_floats, scale_images
from .store import EpisodeArray, FrameStore
from .tables import FrameTable, read_table, true_stages
from .writing import make_once, only_writer

__all__ = [
    "SUBTASK_STYLE",
    "AnyDataset",
    "EpisodeArray",
    "FrameStore",
    "FrameTable",
    "GivenLabels",
    "LocalDataset",
    "Origin",
    "as_floats",
    "cached_frames",
    "check_demonstrations",
    "chosen_cameras",
    "commit_of",
    "content_hashes",
    "dimension_names",
    "download",
    "download_dataset",
    "frame_size",
    "frames_key",
    "given_labels",
    "make_once",
    "only_writer",
    "read_annotations",
    "read_collection",
    "read_table",
    "render_card",
    "require_finite",
    "require_videos",
    "require_whole",
    "scale_images",
    "shown_name",
    "true_stages",
    "upload",
    "upload_dataset",
    "used_size",
]
