"""The multi-sensory representation: one latent per frame from all cameras and proprioception."""

from .configuration import RepresentationConfig
from .encoding import encode_dataset
from .inputs import Modalities
from .pictures import draw_reconstructions
from .trained import Representation
from .training import train_representation

__all__ = [
    "Modalities",
    "Representation",
    "RepresentationConfig",
    "draw_reconstructions",
    "encode_dataset",
    "train_representation",
]
