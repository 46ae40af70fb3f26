"""The multi-sensory representation: one latent per frame from all cameras and proprioception."""

from .configuration import RepresentationConfig
from .encoding import encode_dataset, encode_observations
from .inputs import Modalities
from .pictures import draw_reconstructions
from .trained import REPRESENTATION_FILES, Representation
from .training import is_main_process, train_representation

__all__ = [
    "REPRESENTATION_FILES",
    "Modalities",
    "Representation",
    "RepresentationConfig",
    "draw_reconstructions",
    "encode_dataset",
    "encode_observations",
    "is_main_process",
    "train_representation",
]
