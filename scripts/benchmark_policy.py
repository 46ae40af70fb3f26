"""Times the policy at the paper's sizes: in training, against a plain loop and against ACT, and in acting.

The plain loop trains separate networks as the original does. All in one run on one segmented dataset; quote the ratios.

    python scripts/benchmark_policy.py --root=outputs/serve_skills
"""

import resource
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import islice
from tempfile import TemporaryDirectory

import draccus
import numpy as np
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.datasets import LeRobotDataset
from lerobot.policies import PreTrainedPolicy, make_policy, make_pre_post_processors
from lerobot.policies.act import ACTConfig

from lerobot_buds.core import ACTION
from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.images import random_shift
from lerobot_buds.policy.modeling_buds import BudsPolicy

CHUNK = 100  # ACT's default


@dataclass
class BenchmarkConfig:
    """What is timed, and where."""

    root: str
    batch_size: int = 32
    steps: int = 5
    actions: int = 2000
    environments: int = 10
    device: str = "cpu"
    threads: int = 2
    only: str = ""
    """Part of the name of what shall be timed alone."""


def batches(dataset: LeRobotDataset, config: BenchmarkConfig) -> Iterator[dict]:
    """Loads shuffled batches as ``lerobot-train`` does, in this process."""
    while True:
        yield from torch.utils.data.DataLoader(dataset, config.batch_size, shuffle=True, drop_last=True)


def median_seconds(work: Callable[[], object], repeats: int) -> float:
    """Times some work; the first run, which warms up, does not count."""
    seconds = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        work()
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds[1:]))


def update(policy: PreTrainedPolicy, optimizer: torch.optim.Optimizer, batch: dict) -> None:
    """Does what ``lerobot-train`` does with a batch."""
    policy.train()
    loss, _ = policy.forward(batch)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(policy.parameters(), 10.0)
    optimizer.step()
    optimizer.zero_grad()
    loss.item()


def separate_networks(policy: BudsPolicy, batch: dict) -> Callable[[], None]:
    """Makes the plain loop: every skill and the meta controller with an optimiser of its own, one after the other.

    It gets images, subgoals and labels ready made. As in the original, networks take images in the usual order of
    memory, losses are read after every network, and the meta controller's targets come from finished encoders.
    """
    images, state, task = policy._inputs(batch)
    labels = policy._label_table().lookup(batch["index"])
    goals, images = policy._goal_images(labels.subgoal, images.device).contiguous(), images.contiguous()
    proprio, channels = policy.proprioception(state, labels.history), policy.config.meta_channels
    parts = [*policy.skills.skills, *policy.meta_controllers.controllers]
    optimizers = [torch.optim.Adam(part.parameters(), lr=1e-4) for part in parts]

    def finish(loss: torch.Tensor, optimizer: torch.optim.Optimizer) -> None:
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()
        loss.item()

    def loop() -> None:
        shifted = random_shift(images, 4).contiguous()
        for k, (skill, optimizer) in enumerate(zip(policy.skills.skills, optimizers, strict=False)):
            rows = (labels.skill == k).nonzero()[:, 0]
            if len(rows):
                subgoal = skill.subgoal_encoder(goals[rows])
                actions, _ = skill(shifted[rows], subgoal + 0.1 * torch.randn_like(subgoal), proprio[rows])
                finish((actions[:, 0] - batch[ACTION][rows]).square().sum(), optimizer)
        target = policy.skills.subgoal_targets(labels.skill, goals)
        meta, _ = policy.meta_controllers.losses(shifted[:, :channels], task, labels.skill, target)
        finish((meta.skill_id_loss + meta.subgoal_loss + 1e-4 * meta.kl_loss).mean(), optimizers[-1])

    return loop


def built(settings: PreTrainedConfig, dataset: LeRobotDataset) -> tuple[PreTrainedPolicy, torch.optim.Optimizer]:
    """Builds a policy and its optimiser through LeRobot's factory."""
    torch.manual_seed(0)
    policy = make_policy(settings, ds_meta=dataset.meta)
    return policy, settings.get_optimizer_preset().build(policy.get_optim_params())


def time_training(config: BenchmarkConfig) -> None:
    """Prints seconds a batch takes to load, and an update with it; only what is asked for is built."""
    dataset = LeRobotDataset("local/benchmark", root=config.root)
    stream = batches(dataset, config)
    loading = median_seconds(partial(next, stream), config.steps)
    print(f"loader: {config.batch_size / loading:.0f} frames/s in one process")
    batch = _moved(next(stream), torch.device(config.device))
    works: dict[str, Callable[[], Callable[[], None]]] = {
        "buds, joint": lambda: partial(update, *built(BudsConfig(device=config.device), dataset), batch),
        "plain loop over separate networks": lambda: separate_networks(
            built(BudsConfig(device=config.device), dataset)[0], batch
        ),
        "buds, meta controller alone": lambda: _meta_controller_alone(config, dataset, batch),
        "ACT with its defaults": lambda: _act(config, dataset),
    }
    for name, build in works.items():
        if config.only in name:
            seconds = median_seconds(build(), config.steps)
            print(f"update, {name}: {seconds:.3f} s, {config.batch_size / seconds:.1f} frames/s", flush=True)


def _meta_controller_alone(config: BenchmarkConfig, dataset: LeRobotDataset, batch: dict) -> Callable[[], None]:
    """Skills of a library are frozen, and their subgoal vectors are kept."""
    with TemporaryDirectory() as library:
        built(BudsConfig(device=config.device), dataset)[0].save_pretrained(library)
        return partial(update, *built(BudsConfig(device=config.device, skills_path=library), dataset), batch)


def _act(config: BenchmarkConfig, dataset: LeRobotDataset) -> Callable[[], None]:
    deltas = {ACTION: [i / dataset.fps for i in range(CHUNK)]}
    chunks = LeRobotDataset("local/benchmark", root=config.root, delta_timestamps=deltas)
    # Its weights for ImageNet cannot be fetched everywhere; they do not change the time.
    policy, optimizer = built(ACTConfig(device=config.device, pretrained_backbone_weights=None), dataset)
    prepare, _ = make_pre_post_processors(policy.config, dataset_stats=dataset.meta.stats)
    return partial(update, policy, optimizer, prepare(next(batches(chunks, config))))


def _moved(batch: dict, device: torch.device) -> dict:
    return {key: value.to(device) if isinstance(value, torch.Tensor) else value for key, value in batch.items()}


def time_acting(config: BenchmarkConfig) -> None:
    """Prints how long `select_action` takes, for one environment and for several at once."""
    dataset = LeRobotDataset("local/benchmark", root=config.root)
    policy, _ = built(BudsConfig(device=config.device), dataset)
    policy.eval()
    frames = list(islice((_moved(dataset[i], torch.device(config.device)) for i in range(50)), 50))
    for environments, steps in ((1, config.actions), (config.environments, config.actions // 10)):
        seconds = []
        policy.reset()
        for step in range(steps):
            frame = frames[step % len(frames)]
            batch = {k: v.expand(environments, *v.shape) for k, v in frame.items() if k in policy.config.input_features}
            began = time.perf_counter()
            policy.select_action({**batch, "task": [frame["task"]] * environments}).cpu()
            seconds.append(time.perf_counter() - began)
        p50, p99 = 1e3 * np.percentile(seconds, [50, 99]) / environments
        mean = 1e3 * np.mean(seconds) / environments
        print(
            f"acting, {environments} at once: p50 {p50:.1f} ms, p99 {p99:.1f} ms, mean {mean:.1f} ms each", flush=True
        )


def main() -> None:
    """Prints all timings."""
    config = draccus.parse(BenchmarkConfig)
    torch.set_num_threads(config.threads)
    time_training(config)
    if config.only in "acting":
        time_acting(config)
    print(f"peak memory of all that ran: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.1f} GiB")


if __name__ == "__main__":
    main()
