"""Trains the representation: seeded, resumable to the byte, and the same on every run of one machine."""

import json
import logging
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from accelerate import Accelerator  # type: ignore[import-untyped]
from safetensors import safe_open
from safetensors.torch import load_file, save
from torch import Tensor
from tqdm import tqdm

from lerobot_buds.core import ConfigError, IntArray, sha256_of_json, write_atomically

from .configuration import RepresentationConfig
from .encoding import RECORD_FILE, VERSION, Representation, write_bytes
from .inputs import DatasetInputs, Modalities
from .network import FusionNetwork

logger = logging.getLogger(__name__)

CHECKPOINT_FILE = "checkpoint.safetensors"
# First number of a seed sequence: independent streams of one user seed.
_ORDER, _NOISE, _SPLIT, _VALIDATION = range(4)


def train_representation(
    root: Path, config: RepresentationConfig, output_dir: Path, cache_dir: Path | None = None
) -> Representation:
    """Trains a representation on all episodes of a dataset but the held-out ones.

    A killed run continues from its last checkpoint and ends with the same bytes as an unbroken one. A finished run with
    the same configuration and data is loaded instead of repeated.

    Args:
        root: Folder of a LeRobotDataset, whole on this machine.
        config: Settings.
        output_dir: Receives the representation, and a checkpoint while training.
        cache_dir: Folder of the decoded frames; LeRobot's home where None.

    Returns:
        The trained representation, also saved in `output_dir`.

    Raises:
        DatasetError: The dataset is damaged, incomplete, or lacks a modality.
        ConfigError: The loss diverged.
    """
    modalities = Modalities.select(root, config)
    inputs = DatasetInputs(root, modalities, config.image_size, cache_dir)
    key = sha256_of_json({"version": VERSION, "config": asdict(config), "data": inputs.fingerprint})
    if (output_dir / RECORD_FILE).exists():
        finished = Representation.load(output_dir)
        if finished.training_key == key:
            logger.info("%s holds this representation already", output_dir)
            return finished
    run = _Run(inputs, config, Representation.untrained(modalities, config).network)
    start = run.restore(output_dir / CHECKPOINT_FILE, key)
    with torch.backends.cudnn.flags(deterministic=True, benchmark=False):
        for step in run.progress(start):
            run.step(step)
            if (step + 1) % config.checkpoint_interval == 0 or step + 1 == config.steps:
                run.report(step)
                run.store(output_dir / CHECKPOINT_FILE, key, step + 1)
    network = run.accelerator.unwrap_model(run.network).to("cpu").eval()
    representation = Representation(network, modalities, config, key, run.losses)
    representation.save(output_dir)
    (output_dir / CHECKPOINT_FILE).unlink()
    return representation


def split_episodes(n_episodes: int, fraction: float, seed: int) -> tuple[IntArray, IntArray]:
    """Splits episodes into training and validation, seeded.

    Args:
        n_episodes: Number of episodes.
        fraction: Part to hold out; rounded to whole episodes, never all of them.
        seed: Seed.

    Returns:
        Sorted episode numbers for training and for validation.
    """
    held_out = min(round(fraction * n_episodes), n_episodes - 1)
    order = np.random.default_rng([_SPLIT, seed]).permutation(n_episodes)
    return np.sort(order[held_out:]), np.sort(order[:held_out])


@dataclass
class _Batches:
    """The training frames of every step, a function of (seed, step) alone."""

    frames: IntArray
    batch_size: int
    seed: int
    epoch: int = -1
    order: IntArray | None = None

    def at(self, step: int) -> IntArray:
        per_epoch = max(1, len(self.frames) // self.batch_size)
        epoch, place = divmod(step, per_epoch)
        if self.order is None or epoch != self.epoch:
            self.epoch = epoch
            self.order = np.random.default_rng([_ORDER, self.seed, epoch]).permutation(self.frames)
        return self.order[place * self.batch_size : (place + 1) * self.batch_size]


class _Run:
    """The moving parts of one training run: network, optimizer, batches and the losses so far."""

    def __init__(self, inputs: DatasetInputs, config: RepresentationConfig, network: FusionNetwork) -> None:
        self.inputs, self.config = inputs, config
        training, validation = split_episodes(len(inputs.ends), config.validation_fraction, config.seed)
        self.validation_frames = _frames_of(inputs, validation)
        self.batches = _Batches(_frames_of(inputs, training), config.batch_size, config.seed)
        if network.has_proprioception:
            mean, std = inputs.state_statistics(self.batches.frames)
            network.proprioception_mean.copy_(mean)
            network.proprioception_std.copy_(std)
        self.accelerator = Accelerator(cpu=config.device == "cpu")
        optimizer = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
        self.network, self.optimizer = self.accelerator.prepare(network, optimizer)
        self.losses: list[dict[str, float]] = []
        self.terms: dict[str, Tensor] = {}

    def progress(self, start: int) -> Iterator[int]:
        with tqdm(total=self.config.steps, initial=start, desc="training the representation", unit="step") as bar:
            for step in range(start, self.config.steps):
                yield step
                bar.update()
                if step % 10 == 0:
                    bar.set_postfix(loss=f"{float(self.terms['loss']):.1f}")

    def step(self, step: int) -> None:
        rate = 0.5 * self.config.learning_rate * (1 + math.cos(math.pi * step / self.config.steps))
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        batch = self.inputs.batch(self.batches.at(step), self.accelerator.device)
        terms = self.network(batch, self._noise(batch, _NOISE, step), self.config.kl_weight)
        self.optimizer.zero_grad()
        self.accelerator.backward(terms["loss"])
        self.terms = {name: value.detach() for name, value in terms.items()}
        self.optimizer.step()

    def report(self, step: int) -> None:
        record = {"step": step + 1, **{f"training/{name}": float(value) for name, value in self.terms.items()}}
        if not math.isfinite(record["training/loss"]):
            raise ConfigError(
                f"the loss is {record['training/loss']} at step {step + 1}: training diverged. Lower learning_rate "
                f"(now {self.config.learning_rate})."
            )
        if len(self.validation_frames):
            record |= {f"validation/{name}": value for name, value in self._validate().items()}
        self.losses.append(record)

    @torch.no_grad()
    def _validate(self) -> dict[str, float]:
        sums: dict[str, float] = {}
        for start in range(0, len(self.validation_frames), self.config.batch_size):
            indices = self.validation_frames[start : start + self.config.batch_size]
            batch = self.inputs.batch(indices, self.accelerator.device)
            terms = self.network(batch, self._noise(batch, _VALIDATION, start), self.config.kl_weight)
            for name, value in terms.items():
                sums[name] = sums.get(name, 0.0) + float(value) * len(indices)
        return {name: value / len(self.validation_frames) for name, value in sums.items()}

    def _noise(self, batch: dict[str, Tensor], stream: int, step: int) -> Tensor:
        # Drawn on the CPU, from the step alone: the same on every device and after every resume.
        seed = np.random.SeedSequence([stream, self.config.seed, step]).generate_state(1, np.uint64)[0]
        size = (len(next(iter(batch.values()))), self.config.latent_dim)
        noise = torch.randn(size, generator=torch.Generator().manual_seed(int(seed) >> 1))
        return noise.to(self.accelerator.device)

    def store(self, path: Path, key: str, step: int) -> None:
        network = self.accelerator.unwrap_model(self.network)
        tensors = {f"network/{name}": tensor for name, tensor in network.state_dict().items()}
        for number, state in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer/{number}/{name}": tensor for name, tensor in state.items()}
        tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
        metadata = {"key": key, "step": str(step), "losses": json.dumps(self.losses)}
        content = save(tensors, metadata)
        write_atomically(path, lambda part: write_bytes(part, content))  # safetensors' own errors hide a full disk

    def restore(self, path: Path, key: str) -> int:
        """Loads a checkpoint of this very run if there is one; returns the number of steps done."""
        if not path.exists():
            return 0
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata()
        if metadata["key"] != key:
            logger.warning("%s belongs to another configuration or dataset; training starts anew", path)
            return 0
        tensors = load_file(path)
        network = self.accelerator.unwrap_model(self.network)
        network.load_state_dict({n.removeprefix("network/"): t for n, t in tensors.items() if n.startswith("network/")})
        states: dict[int, dict[str, Tensor]] = {}
        parameters = list(network.parameters())
        for name, tensor in tensors.items():
            if name.startswith("optimizer/"):
                _, number, field = name.split("/")
                # Moments must have their parameter's memory layout: another one could round differently.
                like = torch.empty_like(parameters[int(number)]) if tensor.ndim else torch.empty_like(tensor)
                states.setdefault(int(number), {})[field] = like.detach().copy_(tensor)
        self.optimizer.load_state_dict({"state": states, "param_groups": self.optimizer.state_dict()["param_groups"]})
        self.losses = json.loads(metadata["losses"])
        return int(metadata["step"])


def _frames_of(inputs: DatasetInputs, episodes: IntArray) -> IntArray:
    ranges = [np.arange(inputs.starts[e], inputs.ends[e], dtype=np.int64) for e in episodes]
    return np.concatenate(ranges) if ranges else np.empty(0, dtype=np.int64)
