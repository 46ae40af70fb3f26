"""A trained representation: its files, and the latents of a dataset under it."""

import json
from dataclasses import asdict, dataclass, field
from functools import cached_property
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
from lerobot.utils.constants import HF_LEROBOT_HOME
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from tqdm import tqdm

from lerobot_buds.core import (
    DISTRIBUTION,
    CheckpointError,
    DatasetError,
    FloatArray,
    read_json,
    refuse_newer,
    sha256_of_json,
    write_atomically,
    write_json,
)
from lerobot_buds.demos import make_once

from .configuration import RepresentationConfig
from .inputs import DatasetInputs, Modalities
from .network import FusionNetwork

VERSION = 1
RECORD_FILE = "representation.json"
WEIGHTS_FILE = "representation.safetensors"

_RETRAIN = "remove the folder and train it again"


@dataclass(frozen=True)
class Representation:
    """A network with everything needed to use it again.

    Attributes:
        network: The trained network, on the CPU.
        modalities: What it fuses.
        config: How it was made.
        training_key: Hash of configuration and data that it was trained with.
        losses: One record per checkpoint: ``step`` and the training and validation loss terms.
    """

    network: FusionNetwork
    modalities: Modalities
    config: RepresentationConfig
    training_key: str = ""
    losses: list[dict[str, float]] = field(default_factory=list)

    @classmethod
    def untrained(cls, modalities: Modalities, config: RepresentationConfig) -> "Representation":
        """Makes a representation with seeded random weights; leaves the global random state as it was."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            network = FusionNetwork(
                tuple(modalities.cameras), len(modalities.state_dims), config.image_size, config.latent_dim
            )
        return cls(network, modalities, config)

    @cached_property
    def hash(self) -> str:
        """Content hash of the weights and of what they are applied to; names caches of latents."""
        weights = sha256(self._weights()).hexdigest()
        return sha256_of_json({"weights": weights, "modalities": asdict(self.modalities), "version": VERSION})

    def save(self, folder: Path) -> None:
        """Writes ``representation.safetensors`` and ``representation.json``, each atomically, the record last.

        Args:
            folder: Created where missing.
        """
        weights = self._weights()
        (folder / RECORD_FILE).unlink(missing_ok=True)  # a kill must not leave it beside the weights of another one
        write_atomically(folder / WEIGHTS_FILE, lambda part: write_bytes(part, weights))
        record = {
            "version": VERSION,
            "package_version": version(DISTRIBUTION),
            "config": asdict(self.config),
            "modalities": asdict(self.modalities),
            "training_key": self.training_key,
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
        except (FileNotFoundError, json.JSONDecodeError) as error:
            raise CheckpointError(f"{folder} holds no whole representation ({error}); {_RETRAIN}.") from error
        try:
            refuse_newer(
                folder / RECORD_FILE, record["version"], VERSION, record.get("package_version"), CheckpointError
            )
            stored, known_hash = record["modalities"], record["weights_sha256"]
            modalities = Modalities(
                {name: (int(size[0]), int(size[1])) for name, size in stored["cameras"].items()},
                tuple(stored["state_names"]),
                tuple(stored["state_dims"]),
            )
            blank = cls.untrained(modalities, RepresentationConfig(**record["config"]))
        except (KeyError, TypeError, AttributeError) as error:
            raise CheckpointError(
                f"{folder / RECORD_FILE} is damaged ({type(error).__name__}: {error}); {_RETRAIN}."
            ) from error
        if sha256(content).hexdigest() != known_hash:
            raise CheckpointError(f"{folder / WEIGHTS_FILE} is not the file that {RECORD_FILE} describes; {_RETRAIN}.")
        try:
            blank.network.load_state_dict(load_file(folder / WEIGHTS_FILE))
        except (SafetensorError, RuntimeError) as error:
            raise CheckpointError(f"{folder / WEIGHTS_FILE} does not fit its record ({error}); {_RETRAIN}.") from error
        return cls(blank.network, modalities, blank.config, record["training_key"], record["losses"])

    def _weights(self) -> bytes:
        weights: bytes = save({name: t.contiguous() for name, t in self.network.state_dict().items()})
        return weights


def encode_dataset(
    root: Path, representation: Representation, batch_size: int = 256, cache_dir: Path | None = None
) -> list[FloatArray]:
    """Computes the latent of every frame: the posterior mean of the fused Gaussian (code).

    Latents are kept on disk by the hash of weights and data, so a second call only reads.

    Args:
        root: Folder of a LeRobotDataset, whole on this machine.
        representation: Trained on the same cameras and state.
        batch_size: Frames per pass.
        cache_dir: Folder of decoded frames and latents; ``$HF_LEROBOT_HOME/buds_cache`` where None.

    Returns:
        One ``(T, z)`` float64 array per episode, float32 in precision.

    Raises:
        CheckpointError: The dataset's cameras or state differ from those the representation was trained on.
        DatasetError: The dataset is damaged or incomplete, or a latent is not finite.
        StorageError: The cache cannot be written.
    """
    representation.modalities.require_same(root)
    inputs = DatasetInputs(root, representation.modalities, representation.config.image_size, cache_dir)
    key = sha256_of_json({"representation": representation.hash, "data": inputs.fingerprint, "batch_size": batch_size})
    path = (cache_dir or HF_LEROBOT_HOME / "buds_cache") / f"latents-{key[:32]}.npy"
    make_once(path, lambda part: _write_array(part, _encode(inputs, representation, batch_size)))
    latents = np.load(path, allow_pickle=False).astype(np.float64)
    return [latents[start:end] for start, end in zip(inputs.starts, inputs.ends, strict=True)]


@torch.no_grad()
def _encode(inputs: DatasetInputs, representation: Representation, batch_size: int) -> NDArray[np.float32]:
    device = torch.device("cuda" if torch.cuda.is_available() and representation.config.device == "auto" else "cpu")
    network = representation.network.to(device)
    latents = np.empty((inputs.n_frames, representation.config.latent_dim), dtype=np.float32)
    for start in tqdm(range(0, inputs.n_frames, batch_size), desc="encoding", unit="batch", leave=False):
        indices = np.arange(start, min(start + batch_size, inputs.n_frames))
        latents[indices] = network.encode(inputs.batch(indices, device)).mean.cpu().numpy()
    network.to("cpu")
    bad = np.argwhere(~np.isfinite(latents))
    if len(bad):
        row, dim = bad[0]
        episode = int(np.searchsorted(inputs.ends, row, side="right"))
        raise DatasetError(
            f"the latent of episode {episode}, frame {row - inputs.starts[episode]}, dimension {dim} is "
            f"{latents[row, dim]}, and {len(np.unique(bad[:, 0])) - 1} more frame(s) are affected; the representation "
            "is broken: train it again with a lower learning_rate."
        )
    return latents


def write_bytes(path: Path, content: bytes) -> None:
    """Fills a file."""
    path.write_bytes(content)


def _write_array(path: Path, array: NDArray[np.float32]) -> None:
    with path.open("wb") as file:
        np.save(file, array, allow_pickle=False)
