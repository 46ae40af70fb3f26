"""Trains the policy on frames in memory, and diagnoses it on demonstrations that were held out.

    python scripts/train_in_memory.py --root=outputs/skills --output_dir=outputs/policy --steps=6000 \
        --policy="include configs/policy/buds_cpu.yaml"

Loss, optimiser and schedule are those of lerobot-train; its loader, which takes most of the time with small networks,
is left out. The checkpoint is one that lerobot-eval runs.
"""

import logging
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy, make_pre_post_processors
from tqdm import tqdm

from lerobot_buds.cli.running import parse
from lerobot_buds.core import write_json
from lerobot_buds.data import LocalDataset
from lerobot_buds.evaluation.diagnosis import diagnose
from lerobot_buds.evaluation.recorded import RecordedFrames
from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.modeling_buds import BudsPolicy


@dataclass
class TrainingConfig:
    """Settings of one training."""

    root: Path
    """Folder of the dataset, segmented unless the policy does without."""

    output_dir: Path
    """Where checkpoint and figures go."""

    policy: PreTrainedConfig = field(default_factory=BudsConfig)
    """The policy, as for lerobot-train."""

    steps: int = 4000
    """Training steps."""

    batch_size: int = 64
    """Frames a step."""

    episodes: list[int] | None = None
    """Episodes to use, by number; all where None."""

    held_out: int = 0
    """Every n-th episode is not trained on, and diagnosed; 0 for none."""

    seed: int = 1000
    """Seed of weights and batches."""


def train(config: TrainingConfig) -> None:
    """Trains, saves, diagnoses."""
    torch.set_num_threads(1)
    torch.manual_seed(config.seed)
    rng = np.random.default_rng(config.seed)
    meta = LeRobotDatasetMetadata("local/demonstrations", root=config.root)
    policy = make_policy(config.policy, ds_meta=meta)
    assert isinstance(policy, BudsPolicy)
    chosen = None if config.episodes is None else tuple(config.episodes)
    frames = RecordedFrames(LocalDataset(config.root, chosen), policy)
    episodes = np.arange(len(frames.starts))
    held_out = episodes[config.held_out // 2 :: config.held_out] if config.held_out else episodes[:0]
    rows = np.concatenate([np.arange(frames.starts[e], frames.ends[e]) for e in np.setdiff1d(episodes, held_out)])
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    scheduler = policy.config.get_scheduler_preset().build(optimizer, config.steps)
    policy.train()
    shown: dict[str, float] = {}
    began = time.perf_counter()
    order = rows[:0]
    with tqdm(range(config.steps), dynamic_ncols=True, mininterval=10) as bar:
        for step in bar:
            if len(order) < config.batch_size:
                order = rng.permutation(rows)
            batch, order = order[: config.batch_size], order[config.batch_size :]
            labels = frames.labels(batch)
            terms = policy.model(frames.observation(batch), labels, *frames.actions(batch))
            loss = policy.model.loss(terms, labels).mean()
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(policy.parameters(), policy.config.optimizer_grad_clip_norm)
            optimizer.step()
            scheduler.step()
            if step % 50 == 0:
                for name, term in terms.items():
                    shown[name] = 0.9 * shown.get(name, term.mean().item()) + 0.1 * term.mean().item()
                bar.set_postfix({name: f"{value:.3f}" for name, value in shown.items()})
    seconds = time.perf_counter() - began
    folder = config.output_dir / "pretrained_model"
    policy.save_pretrained(folder)
    for pipeline in make_pre_post_processors(policy.config, dataset_stats=meta.stats):
        pipeline.save_pretrained(folder)
    report = {"steps": config.steps, "seconds": round(seconds, 1), "seed": config.seed, "losses": shown}
    if len(held_out):
        report["held_out"] = diagnose(policy, frames, held_out)
    write_json(config.output_dir / "training.json", report)
    logging.info("%s", report)


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
    train(parse(TrainingConfig))
