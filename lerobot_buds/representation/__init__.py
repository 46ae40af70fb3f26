"""The multi-sensory representation: one latent per frame from all cameras and proprioception.

Importing this folder loads nothing; a name loads its module, of which that with the settings needs no torch.
"""

from typing import TYPE_CHECKING

from lerobot_buds.core import on_demand

if TYPE_CHECKING:
    from .configuration import RepresentationConfig
    from .encoding import encode_dataset, encode_observations
    from .inputs import Modalities
    from .pictures import draw_reconstructions
    from .trained import REPRESENTATION_FILES, Representation
    from .training import is_main_process, leave_processes, train_representation
else:
    __getattr__ = on_demand(__name__)

__all__ = [
    "REPRESENTATION_FILES",
    "Modalities",
    "Representation",
    "RepresentationConfig",
    "draw_reconstructions",
    "encode_dataset",
    "encode_observations",
    "is_main_process",
    "leave_processes",
    "train_representation",
]
