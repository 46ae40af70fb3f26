"""The file of a skill library, kept in the segmented dataset's ``meta/buds`` so that it travels to the Hub with it."""

from hashlib import sha256
from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from lerobot_buds.core import EXEMPLARS_FILE, SegmentationError, write_atomically

from .library import SkillLibrary


def write_library(root: Path, library: SkillLibrary) -> str:
    """Writes a library into a dataset, atomically; features are kept in single precision.

    Args:
        root: Folder of the dataset.
        library: The library.

    Returns:
        Hash of the file.
    """
    content: bytes = save(
        {
            "features": library.features.astype(np.float32),
            "skills": library.skills,
            "episodes": library.episodes,
            "sizes": np.array([library.n_skills, library.num_keyframes], dtype=np.int64),
        }
    )
    write_atomically(root / EXEMPLARS_FILE, lambda part: part.write_bytes(content))
    return sha256(content).hexdigest()


def read_library(root: Path) -> SkillLibrary:
    """Reads the library of a segmented dataset.

    Args:
        root: Folder of the dataset.

    Raises:
        SegmentationError: The file is missing or damaged.
    """
    path = root / EXEMPLARS_FILE
    try:
        stored = load(path.read_bytes())
        n_skills, num_keyframes = stored["sizes"].tolist()
        features = stored["features"].astype(np.float64)
        return SkillLibrary(features, stored["skills"], stored["episodes"], n_skills, num_keyframes)
    except (FileNotFoundError, SafetensorError, KeyError, ValueError) as error:
        raise SegmentationError(
            f"{path} holds no exemplars of skills ({type(error).__name__}: {error}). Fetch that dataset again, or "
            "segment the one that it was made from into another --output_root."
        ) from error
