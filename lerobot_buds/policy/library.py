"""Takes the skills of a trained policy over into a new one, which trains a meta controller on them only."""

import logging
from dataclasses import dataclass
from pathlib import Path

from draccus.utils import ParsingError
from lerobot.configs import PreTrainedConfig
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from lerobot_buds.core import CheckpointError, sha256_of_file
from lerobot_buds.data import commit_of, download, shown_name

from .configuration_buds import LIBRARY_FIELDS, BudsConfig

logger = logging.getLogger(__name__)

PARTS = ("skills", "proprioception", "actions", "goals")
"""Modules of `BudsModel` that make up its skills."""

_MODEL = "model."

_CONFIG, _WEIGHTS = "config.json", "model.safetensors"


@dataclass(frozen=True)
class TrainedSkills:
    """The skills of a checkpoint.

    Attributes:
        name: Where they come from.
        config: Configuration of that policy.
        tensors: Weights and buffers of `PARTS`, by their names in the model.
        origin: Repository or folder, commit where it was fetched, and hash of the weights' file.
    """

    name: str
    config: BudsConfig
    tensors: dict[str, Tensor]
    origin: dict[str, str]

    @classmethod
    def read(cls, name: str) -> "TrainedSkills":
        """Reads the skills of a checkpoint, and nothing else of it.

        Args:
            name: Folder of a policy's checkpoint, or its repository on the Hub.

        Raises:
            CheckpointError: It cannot be had, is damaged, or is not a policy with skills.
        """
        folder = Path(name)
        if not folder.is_dir():
            folder = download(name, [_CONFIG, _WEIGHTS])
        try:
            config = PreTrainedConfig.from_pretrained(folder, local_files_only=True)
            with safe_open(folder / _WEIGHTS, framework="pt") as file:
                names = [name.removeprefix(_MODEL) for name in file.keys()]  # noqa: SIM118 (not a dictionary)
                tensors = {n: file.get_tensor(_MODEL + n) for n in names if n.split(".")[0] in PARTS}
        except (OSError, ValueError, KeyError, SafetensorError, ParsingError) as error:
            raise CheckpointError(f"{name} holds no readable policy ({type(error).__name__}: {error}).") from error
        if not isinstance(config, BudsConfig) or not config.has_subgoals:
            kind = "flat policy" if isinstance(config, BudsConfig) else f"policy of type {config.type!r}"
            raise CheckpointError(f"{name} holds a {kind}, without skills to take over.")
        origin = {"repo_id": shown_name(name), "sha256": sha256_of_file(folder / _WEIGHTS)}
        if (commit := commit_of(folder)) is not None:
            origin["commit"] = commit
        return cls(name, config, tensors, origin)

    def adopt(self, config: BudsConfig) -> None:
        """Makes a new configuration's skills those of this one.

        Args:
            config: Changed in place: `LIBRARY_FIELDS`, and the cameras and the state where it has none yet.

        Raises:
            CheckpointError: Cameras, state or actions have other shapes.
            ConfigError: Settings of the new one do not fit those of the library.
        """
        for kind in ("input_features", "output_features"):
            mine, theirs = getattr(self.config, kind), getattr(config, kind)
            for key, feature in mine.items():
                found = theirs.get(key)
                if found is None or tuple(found.shape) != tuple(feature.shape):
                    raise CheckpointError(
                        f"The skills of {self.name} need {key} of shape {tuple(feature.shape)}, the data has "
                        f"{'none' if found is None else tuple(found.shape)}. It has {sorted(theirs)}."
                    )
            setattr(config, kind, dict(mine))
        for name in LIBRARY_FIELDS:
            setattr(config, name, getattr(self.config, name))
        config.parents = {**config.parents, "skills": self.origin}
        config.__post_init__()

    def load_into(self, model: nn.Module) -> None:
        """Copies the weights into a model whose configuration has adopted this one's.

        Args:
            model: Its modules `PARTS` are overwritten.

        Raises:
            CheckpointError: Names or shapes of the weights differ.
        """
        for part in PARTS:
            tensors = {k.removeprefix(f"{part}."): v for k, v in self.tensors.items() if k.startswith(f"{part}.")}
            if getattr(model, part) is None:
                continue  # there are latent goals in some only
            try:
                model.get_submodule(part).load_state_dict(tensors)
            except RuntimeError as error:
                raise CheckpointError(f"The skills of {self.name} do not fit their configuration: {error}") from error
        logger.info("Took %d skills over from %s; they are frozen.", self.config.n_skills, self.name)
