"""A trained representation: its files, on this machine and on the Hub."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from lerobot_buds.core import (
    CARD_FILE,
    DISTRIBUTION,
    CheckpointError,
    read_json,
    refuse_newer,
    sha256_of_json,
    write_atomically,
    write_json,
)
from lerobot_buds.data import commit_of, download, upload

from .card import write_card
from .configuration import RepresentationConfig
from .frozen import FrozenFeatures
from .inputs import Modalities
from .network import FusionNetwork
from .reports import Report

VERSION = 2  # 2: early stopping, backbones, proprioception beside the fused latent
RECORD_FILE = "representation.json"
WEIGHTS_FILE = "representation.safetensors"
REPRESENTATION_FILES = (RECORD_FILE, WEIGHTS_FILE)

_SEEDING = Lock()  # layers draw their weights from a generator of the whole process

_RETRAIN = "remove the folder and train it again"


@dataclass(frozen=True)
class Representation:
    """A network with everything needed to use it again.

    Attributes:
        network: The trained network, on the CPU. `latents` is what both kinds have in common.
        modalities: What it fuses.
        config: How it was made.
        training_key: Hash of configuration and data that it was trained with.
        losses: One report per checkpoint; those after `kept_report` led to early stopping. Empty with a backbone.
        trained_on: The dataset that it was trained on, as far as it is known: see `data.Origin`.
        commit: The commit that it was fetched from; None where it was not fetched.
    """

    network: FusionNetwork | FrozenFeatures
    modalities: Modalities
    config: RepresentationConfig
    training_key: str = ""
    losses: list[Report] = field(default_factory=list)
    trained_on: dict[str, str] = field(default_factory=dict)
    commit: str | None = None

    @classmethod
    def untrained(
        cls,
        modalities: Modalities,
        config: RepresentationConfig,
        backbone_weights: Mapping[str, Tensor] | None = None,
    ) -> "Representation":
        """Makes a representation with seeded random weights; leaves the global random state as it was.

        Args:
            modalities: What to fuse.
            config: Settings.
            backbone_weights: Weights of the backbone, if there is one and it is not to be random.

        Raises:
            ConfigError: timm is not installed, or cannot build the backbone.
        """
        cameras, dims = tuple(modalities.cameras), len(modalities.state_dims)
        network: FusionNetwork | FrozenFeatures
        with _SEEDING, torch.random.fork_rng(devices=[]):
            # Not torch.manual_seed, which would seed the accelerators' generators as well, and for good.
            torch.default_generator.manual_seed(config.seed)
            if config.backbone is None:
                network = FusionNetwork(
                    cameras, dims, config.image_size, config.latent_dim, config.proprioception_weight
                )
            else:
                network = FrozenFeatures(cameras, dims, config, backbone_weights)
        return cls(network, modalities, config)

    @property
    def draws(self) -> bool:
        """Whether images can be reconstructed from its latents."""
        return isinstance(self.network, FusionNetwork) and bool(self.modalities.cameras)

    @property
    def dims_beside(self) -> int:
        """How many of the latents' last dimensions are proprioception that stands beside what is fused."""
        return len(self.modalities.state_dims) if self.config.proprioception_weight else 0

    @property
    def width(self) -> int:
        """Dimensions of a latent."""
        parts = 1 if self.config.backbone is None else len(self.modalities.cameras)
        return parts * self.config.latent_dim + self.dims_beside

    @cached_property
    def hash(self) -> str:
        """Content hash of the weights and of what they are applied to; names caches of latents."""
        weights = sha256(self._weights()).hexdigest()
        modalities, beside = asdict(self.modalities), self.config.proprioception_weight
        return sha256_of_json({"weights": weights, "modalities": modalities, "beside": beside, "version": VERSION})

    def save(self, folder: Path) -> None:
        """Writes ``representation.safetensors`` and ``representation.json``, each atomically, the record last.

        A backbone's weights are among them, so that the two files are all that is needed anywhere.

        Args:
            folder: Created where missing.
        """
        weights = self._weights()
        (folder / RECORD_FILE).unlink(missing_ok=True)  # a kill must not leave it beside the weights of another one
        write_atomically(folder / WEIGHTS_FILE, lambda part: part.write_bytes(weights))
        record = {
            "version": VERSION,
            "package_version": version(DISTRIBUTION),
            "config": asdict(self.config),
            "modalities": asdict(self.modalities),
            "training_key": self.training_key,
            "trained_on": self.trained_on,
            "weights_sha256": sha256(weights).hexdigest(),
            "losses": self.losses,
        }
        write_json(folder / RECORD_FILE, record)

    @classmethod
    def load(cls, folder: Path) -> "Representation":
        """Reads what `save` wrote.

        Args:
            folder: Folder with both files.

        Raises:
            CheckpointError: A file is missing or damaged, the two do not belong together, or are of a newer version.
        """
        try:
            record = read_json(folder / RECORD_FILE)
            content = (folder / WEIGHTS_FILE).read_bytes()
        except (FileNotFoundError, ValueError) as error:
            raise CheckpointError(f"{folder} holds no whole representation ({error}); {_RETRAIN}.") from error
        modalities, config = _described(record, folder / RECORD_FILE)
        if sha256(content).hexdigest() != record["weights_sha256"]:
            raise CheckpointError(f"{folder / WEIGHTS_FILE} is not the file that {RECORD_FILE} describes; {_RETRAIN}.")
        network = cls.untrained(modalities, config).network
        scales = ("latent_scale", "proprioception_scale")
        earlier = dict.fromkeys(scales, torch.ones(())) if record["version"] < 2 else {}
        try:
            network.load_state_dict(earlier | load(content))
        except (SafetensorError, RuntimeError) as error:
            raise CheckpointError(f"{folder / WEIGHTS_FILE} does not fit its record ({error}); {_RETRAIN}.") from error
        return cls(network, modalities, config, record["training_key"], record["losses"], record.get("trained_on", {}))

    @classmethod
    def from_pretrained(cls, name: str | Path, revision: str | None = None) -> "Representation":
        """Reads a representation from a folder or from the Hub.

        Args:
            name: Folder with both files, or a repository, for example ``"me/representation"``.
            revision: Branch, tag or commit of the repository; the main branch where None.

        Raises:
            CheckpointError: There is none, it cannot be reached, or its files cannot be used.
        """
        if Path(name).is_dir():
            return cls.load(Path(name))
        folder = download(str(name), REPRESENTATION_FILES, revision)
        return replace(cls.load(folder), commit=commit_of(folder))

    def push_to_hub(self, repo_id: str, private: bool | None = None, branch: str | None = None) -> str:
        """Puts both files and a card into a repository of the Hub, which is created where it is missing.

        Args:
            repo_id: For example ``"me/representation"``.
            private: Whether a new repository is private; None for the account's own default.
            branch: Where to put them, created where missing; the main branch where None.

        Returns:
            Address of the repository.

        Raises:
            CheckpointError: The repository may not be written, or cannot be reached.
        """
        with TemporaryDirectory() as place:
            folder = Path(place)
            self.save(folder)
            write_card(folder / CARD_FILE, read_json(folder / RECORD_FILE), repo_id)
            files = {name: folder / name for name in (*REPRESENTATION_FILES, CARD_FILE)}
            return upload(files, repo_id, "Upload a representation", private=private, branch=branch)

    def _weights(self) -> bytes:
        weights: bytes = save({name: t.contiguous() for name, t in self.network.state_dict().items()})
        return weights


def _described(record: Any, path: Path) -> tuple[Modalities, RepresentationConfig]:
    """Reads what a record says of the network, and makes sure that the rest of it is there."""
    try:
        refuse_newer(path, record["version"], VERSION, record.get("package_version"), CheckpointError)
        stored = record["modalities"]
        modalities = Modalities(
            {name: (int(size[0]), int(size[1])) for name, size in stored["cameras"].items()},
            tuple(stored["state_names"]),
            tuple(stored["state_dims"]),
        )
        earlier = {"proprioception_weight": 0.0} if record["version"] < 2 else {}
        config = RepresentationConfig(**(earlier | record["config"]))
        _ = record["weights_sha256"], record["training_key"], record["losses"]
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f"{path} is damaged ({type(error).__name__}: {error}); {_RETRAIN}.") from error
    return modalities, config
