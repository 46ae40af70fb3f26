"""One training run of the auto-encoder: resumable to the byte, and shared out over processes."""

import json
import logging
import math
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

import numpy as np
import torch
from accelerate import Accelerator  # type: ignore[import-untyped]
from safetensors import safe_open
from safetensors.torch import load_file, save
from torch import Tensor
from tqdm import tqdm

from lerobot_buds.core import ConfigError, IntArray, write_atomically

from .configuration import RepresentationConfig
from .feed import Feed, sent
from .network import FusionNetwork
from .reports import Report, kept_report, out_of_patience

logger = logging.getLogger(__name__)

CHECKPOINT_FILE = "checkpoint.safetensors"
_DETERMINISTIC = Lock()  # cuDNN's flags belong to the whole process: of two trainings in threads, one waits
# First number of a seed sequence: independent streams of one user seed.
_ORDER, _NOISE, _VALIDATION = 0, 1, 3


@dataclass
class _Order:
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


class TrainingRun:
    """Gradient steps, reports and checkpoints of an auto-encoder; everything random depends on the step alone.

    Args:
        feed: The dataset, on the accelerator's device.
        config: Settings.
        network: What to train, in place.
        accelerator: The devices and processes; each takes every n-th frame of a batch.
        training: ``(N,)`` frames to train on.
        validation: ``(M,)`` frames held out; may be empty.

    Raises:
        ConfigError: A batch has fewer frames than there are processes.
    """

    def __init__(
        self,
        feed: Feed,
        config: RepresentationConfig,
        network: FusionNetwork,
        accelerator: Accelerator,
        training: IntArray,
        validation: IntArray,
    ) -> None:
        smallest = min(config.batch_size, len(training))
        if smallest < accelerator.num_processes:
            raise ConfigError(f"a batch of {smallest} frames is too small for {accelerator.num_processes} processes.")
        self.feed, self.config, self.accelerator, self.bare = feed, config, accelerator, network
        self.order = _Order(training, smallest, config.seed)
        self.validation_frames = validation
        if network.has_proprioception:
            mean, std = feed.inputs.state_statistics(training)
            network.proprioception_mean.copy_(mean)
            network.proprioception_std.copy_(std)
        # One kernel for all parameters; a CPU keeps the loop, and with it the bits it has always had.
        fused = True if accelerator.device.type == "cuda" else None
        optimizer = torch.optim.Adam(network.parameters(), lr=config.learning_rate, fused=fused)
        self.network, self.optimizer = accelerator.prepare(network, optimizer)
        self.losses: list[Report] = []
        self.terms: dict[str, Tensor] = {}
        self.kept: dict[str, Tensor] = {}
        self.go_on_from(0)

    def complete(self, checkpoint: Path, key: str) -> list[Report]:
        """Trains to the end, from the checkpoint if it is one of this very run.

        Args:
            checkpoint: File to go on from and to write to.
            key: Hash of configuration and data.

        Returns:
            All reports; the network has the weights of `kept_report`.

        Raises:
            ConfigError: The loss diverged.
        """
        start = self._restore(checkpoint, key)
        self.go_on_from(start)
        with _DETERMINISTIC, deterministic_convolutions():
            for step in self._remaining(start):
                self.step(step)
                if (step + 1) % self.config.checkpoint_interval == 0 or step + 1 == self.config.steps:
                    self._report(step)
                    if self.accelerator.is_main_process:
                        self._store(checkpoint, key, step + 1)
        # Takes the autocast off again, which preparing has put around the network's own forward.
        self.accelerator.unwrap_model(self.network, keep_fp32_wrapper=False).load_state_dict(self.kept)
        return self.losses

    def _remaining(self, start: int) -> Iterator[int]:
        steps, quiet = self.config.steps, not self.accelerator.is_main_process
        with tqdm(total=steps, initial=start, desc="training the representation", unit="step", disable=quiet) as bar:
            for step in range(start, steps):
                if out_of_patience(self.losses, self.config.patience):
                    logger.info("no lower validation loss in %d reports: ends at step %d", self.config.patience, step)
                    return
                yield step
                bar.update()
                if step % 10 == 0:
                    bar.set_postfix(loss=f"{float(self.terms['loss']):.1f}")

    def go_on_from(self, step: int) -> None:
        """Has the batches ready from a step on; every call of `step` takes the next one."""
        steps = range(step, self.config.steps)
        self.batches = self.feed.batches(self._mine(self.order.at(number)) for number in steps)

    def step(self, step: int) -> None:
        """Takes one gradient step, the one after the last, or that of `go_on_from`."""
        rate = 0.5 * self.config.learning_rate * (1 + math.cos(math.pi * step / self.config.steps))
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        batch = next(self.batches)
        noise = self._noise(self.order.batch_size, _NOISE, step)
        terms = self.network(batch, noise, self.config.kl_weight)
        self.optimizer.zero_grad()
        # Gradients are averaged over the processes, whose shares may differ by a frame.
        weight = len(noise) * self.accelerator.num_processes / self.order.batch_size
        self.accelerator.backward(weight * terms["loss"])
        self.terms = {name: weight * value.detach() for name, value in terms.items()}
        self.optimizer.step()

    def _mine[Rows: (IntArray, Tensor)](self, rows: Rows) -> Rows:
        """Cuts this process's share out of a whole batch's rows."""
        return rows[self.accelerator.process_index :: self.accelerator.num_processes]

    def _noise(self, length: int, stream: int, step: int) -> Tensor:
        """Draws the noise of this process's share of a batch."""
        # Drawn on the CPU, for the whole batch and from the step alone: the same on every device, with any number of
        # processes and after every resume.
        seed = np.random.SeedSequence([stream, self.config.seed, step]).generate_state(1, np.uint64)[0]
        size = (length, self.config.latent_dim)
        noise = torch.randn(size, generator=torch.Generator().manual_seed(int(seed) >> 1))
        return sent(self._mine(noise), self.accelerator.device)

    def _report(self, step: int) -> None:
        terms = self.accelerator.reduce(torch.stack(list(self.terms.values())), "mean").tolist()
        report = {"step": step + 1, **{f"training/{name}": term for name, term in zip(self.terms, terms, strict=True)}}
        if not math.isfinite(report["training/loss"]):
            raise ConfigError(
                f"the loss is {report['training/loss']} at step {step + 1}: training diverged. Lower learning_rate "
                f"(now {self.config.learning_rate})."
            )
        if len(self.validation_frames):
            report |= {f"validation/{name}": value for name, value in self._validate().items()}
        self.losses.append(report)
        if kept_report(self.losses) == len(self.losses) - 1:
            self.kept = {name: tensor.clone() for name, tensor in self.bare.state_dict().items()}

    @torch.no_grad()
    def _validate(self) -> dict[str, float]:
        sums = torch.zeros(len(self.terms), dtype=torch.float64, device=self.accelerator.device)
        starts = range(0, len(self.validation_frames), self.config.batch_size)
        wholes = [self.validation_frames[start : start + self.config.batch_size] for start in starts]
        batches = self.feed.batches(map(self._mine, wholes))
        for start, whole, batch in zip(starts, wholes, batches, strict=True):
            noise = self._noise(len(whole), _VALIDATION, start)
            if len(noise):
                # Not through the wrapper of several processes, which would wait for those without a frame.
                terms = self.bare(batch, noise, self.config.kl_weight)
                sums += torch.stack(list(terms.values())).double() * len(noise)
        means = self.accelerator.reduce(sums, "sum") / len(self.validation_frames)
        return dict(zip(self.terms, means.tolist(), strict=True))

    def _store(self, path: Path, key: str, step: int) -> None:
        tensors = {f"network/{name}": tensor for name, tensor in self.bare.state_dict().items()}
        tensors |= {f"kept/{name}": tensor for name, tensor in self.kept.items()}
        for number, state in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer/{number}/{name}": tensor for name, tensor in state.items()}
        tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
        metadata = {"key": key, "step": str(step), "losses": json.dumps(self.losses)}
        content = save(tensors, metadata)
        write_atomically(path, lambda part: part.write_bytes(content))  # safetensors' own errors hide a full disk

    def _restore(self, path: Path, key: str) -> int:
        """Loads a checkpoint of this very run if there is one; returns the number of steps done."""
        if not path.exists():
            return 0
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata()
        if metadata["key"] != key:
            logger.warning("%s belongs to another configuration or dataset; training starts anew", path)
            return 0
        tensors = load_file(path)
        self.bare.load_state_dict(_under("network/", tensors))
        self.kept = _under("kept/", tensors)
        states: dict[int, dict[str, Tensor]] = {}
        parameters = list(self.bare.parameters())
        for name, tensor in _under("optimizer/", tensors).items():
            number, field = name.split("/")
            # Moments must have their parameter's memory layout: another one could round differently.
            like = torch.empty_like(parameters[int(number)]) if tensor.ndim else torch.empty_like(tensor)
            states.setdefault(int(number), {})[field] = like.detach().copy_(tensor)
        self.optimizer.load_state_dict({"state": states, "param_groups": self.optimizer.state_dict()["param_groups"]})
        self.losses = json.loads(metadata["losses"])
        return int(metadata["step"])


def deterministic_convolutions() -> AbstractContextManager[None]:
    """Has cuDNN choose algorithms by rule, not by a race, and only those that sum in one order.

    Its other flags stay as they are; they are named, since PyTorch would switch what is not named off, cuDNN itself
    included.
    """
    cudnn = torch.backends.cudnn
    flags: AbstractContextManager[None] = cudnn.flags(
        enabled=cudnn.enabled, allow_tf32=cudnn.allow_tf32, deterministic=True, benchmark=False
    )
    return flags


def _under(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}
