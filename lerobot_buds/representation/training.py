"""Trains the representation on whatever devices there are, seeded and the same on every run of one machine."""

import logging
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from accelerate import Accelerator, PartialState  # type: ignore[import-untyped]

from lerobot_buds.core import ConfigError, IntArray, sha256_of_json
from lerobot_buds.data import AnyDataset, Origin

from .configuration import RepresentationConfig
from .feed import Feed
from .frozen import FrozenFeatures, pretrained_weights
from .inputs import DatasetInputs, Modalities
from .network import FusionNetwork
from .run import CHECKPOINT_FILE, TrainingRun
from .trained import RECORD_FILE, VERSION, Representation

logger = logging.getLogger(__name__)

FIT_FRAMES = 4096
"""Training frames at most that projections and scales are fitted to (ours): enough for the covariance of a backbone's
channels."""
FIT_BATCH = 32
_SPLIT, _FIT = 2, 4  # first numbers of seed sequences; the run has its own


def train_representation(
    dataset: AnyDataset, config: RepresentationConfig, output_dir: Path, cache_dir: Path | None = None
) -> Representation:
    """Trains a representation on all episodes of a dataset but the held-out ones.

    A killed run continues from its last checkpoint and ends with the same bytes as an unbroken one. A finished run with
    the same configuration and data is loaded instead of repeated. Under ``accelerate launch`` every process takes its
    share of each batch, the first alone writes, and all return the same; up to rounding it is what one process makes.

    Args:
        dataset: What stands for the dataset; its chosen episodes must be whole on this machine.
        config: Settings.
        output_dir: Receives the representation, and a checkpoint while training.
        cache_dir: Folder of the frame store; in LeRobot's home where None.

    Returns:
        The trained representation, also saved in `output_dir`.

    Raises:
        DatasetError: The dataset is damaged, incomplete, or lacks a modality.
        ConfigError: The loss diverged, or the backbone or the devices cannot be used as asked.
        CheckpointError: The weights of the backbone cannot be had.
    """
    accelerator = _accelerator(config)
    modalities = Modalities.select(dataset, config)
    inputs = DatasetInputs(dataset, modalities, config.side, cache_dir)
    key = sha256_of_json({"version": VERSION, "config": asdict(config), "data": inputs.fingerprint})
    if (output_dir / RECORD_FILE).exists():
        finished = Representation.load(output_dir)
        if finished.training_key == key:
            logger.info("%s holds this representation already", output_dir)
            return finished
    weights = pretrained_weights(config) if config.backbone else None
    network = Representation.untrained(modalities, config, weights).network
    split = split_episodes(len(inputs.ends), config.validation_fraction, config.seed)
    training, validation = (inputs.frames_of(episodes) for episodes in split)
    feed = Feed(inputs, accelerator.device, again=isinstance(network, FusionNetwork))
    if isinstance(network, FusionNetwork):
        run = TrainingRun(feed, config, network, accelerator, training, validation)
        losses = run.complete(output_dir / CHECKPOINT_FILE, key)
    else:
        losses = []
    _fit(network, feed, training, config.seed)
    parent = Origin.of(dataset).known
    representation = Representation(network.to("cpu").eval(), modalities, config, key, losses, parent)
    # No process may still look for a finished one when it appears, and none return before it is there.
    accelerator.wait_for_everyone()
    if accelerator.is_main_process:
        representation.save(output_dir)
        (output_dir / CHECKPOINT_FILE).unlink(missing_ok=True)
    accelerator.wait_for_everyone()
    return representation


def is_main_process(config: RepresentationConfig) -> bool:
    """Tells whether this is the only process, or the first of ``accelerate launch``; only that one may write.

    Args:
        config: Settings of the representation that is trained.
    """
    return bool(PartialState(cpu=config.device == "cpu").is_main_process)


def leave_processes() -> None:
    """Leaves the others of ``accelerate launch`` when all is shared: a process that ends connected may be aborted."""
    if torch.distributed.is_initialized():
        PartialState().destroy_process_group()


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


def _accelerator(config: RepresentationConfig) -> Accelerator:
    cpu = config.device == "cpu"
    precision = config.mixed_precision
    if precision == "auto":
        on_gpu = PartialState(cpu=cpu).device.type == "cuda"
        precision = "bf16" if on_gpu and torch.cuda.is_bf16_supported(including_emulation=False) else "no"
    try:
        return Accelerator(cpu=cpu, mixed_precision=precision)
    except ValueError as error:
        raise ConfigError(
            f"device={config.device!r} and mixed_precision={config.mixed_precision!r} differ from those that this "
            f"process has trained with, and it can have one of each only; start another one ({error})."
        ) from error


def _fit(network: FusionNetwork | FrozenFeatures, feed: Feed, frames: IntArray, seed: int) -> None:
    chosen = np.random.default_rng([_FIT, seed]).permutation(frames)[:FIT_FRAMES]
    network.to(feed.device)
    network.fit(feed.batches(np.array_split(np.sort(chosen), -(-len(chosen) // FIT_BATCH))))
