"""Times the policy: in training, against a flat one, a plain loop and ACT, and in acting.

The plain loop trains separate networks as the original does. All in one run on one segmented dataset; quote the ratios.

    python scripts/benchmark_policy.py --root=outputs/serve_skills
    python scripts/benchmark_policy.py --root=outputs/serve_skills --policy="include configs/policy/buds_cpu.yaml"
"""

import resource
import time
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import cycle, islice
from tempfile import TemporaryDirectory
from typing import Any

import draccus
import numpy as np
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.datasets import LeRobotDataset
from lerobot.policies import PreTrainedPolicy, make_policy, make_pre_post_processors
from lerobot.policies.act import ACTConfig

from lerobot_buds.core import ACTION
from lerobot_buds.data import as_floats
from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.graphs import WATCHED
from lerobot_buds.policy.inputs import read_actions, read_inputs
from lerobot_buds.policy.labels import Labels
from lerobot_buds.policy.modeling_buds import BudsPolicy
from lerobot_buds.policy.networks import random_shift

CHUNK = 100  # ACT's default
WARM_UP = 20  # steps of acting that do not count


@dataclass
class BenchmarkConfig:
    """What is timed, and where."""

    root: str
    policy: PreTrainedConfig = field(default_factory=BudsConfig)
    """Of type `buds`, with a segmented dataset's skills; the paper's sizes where nothing is said."""
    batch_size: int = 32
    steps: int = 5
    actions: int = 2000
    environments: int = 10
    device: str = "cpu"
    threads: int = 2
    workers: int = 0
    """Processes that load; 0 for this one."""
    amp: bool = False
    """Trains in bfloat16, as ``lerobot-train`` does with ``--policy.use_amp=true``; the plain loop stays in float32."""
    compiled: bool = False
    """Compiles the encoders of `buds`."""
    graphs: bool = False
    """Trains `buds` with CUDA graphs; its policy needs group normalisation."""
    only: str = ""
    """Part of the name of what shall be timed alone."""

    def asks_for(self, name: str) -> bool:
        """Tells whether something is to be timed."""
        return self.only in name


def batches(dataset: LeRobotDataset, config: BenchmarkConfig) -> Iterator[dict]:
    """Loads shuffled batches as ``lerobot-train`` does."""
    while True:
        yield from torch.utils.data.DataLoader(
            dataset, config.batch_size, shuffle=True, drop_last=True, num_workers=config.workers
        )


def median_seconds(work: Callable[[], object], repeats: int) -> float:
    """Times some work; the first runs, as many as `warm_ups` says, do not count."""
    seconds = []
    for _ in range(warm_ups(repeats) + repeats):
        began = time.perf_counter()
        work()
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds[warm_ups(repeats) :]))


def warm_ups(repeats: int) -> int:
    """Counts the runs that go before those that are timed."""
    return max(1, repeats // 4)


def update(policy: PreTrainedPolicy, optimizer: torch.optim.Optimizer, amp: bool, batch: dict) -> None:
    """Does what ``lerobot-train`` does with a batch."""
    policy.train()
    with torch.autocast(policy.config.device, enabled=amp, dtype=torch.bfloat16):
        loss, _ = policy.forward(batch)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(policy.parameters(), 10.0)
    optimizer.step()
    optimizer.zero_grad()
    loss.item()


def separate_networks(policy: BudsPolicy) -> Callable[[dict], None]:
    """Makes the plain loop: every skill and the meta controllers with an optimiser of their own, one after the other.

    As in the original, networks take images in the usual order of memory, losses are read after every network, and the
    meta controller's targets come from finished encoders.
    """
    model = policy.model
    parts = [*model.skills.skills, model.meta_controllers]
    *skill_optimizers, meta_optimizer = [torch.optim.Adam(part.parameters(), lr=1e-4) for part in parts]

    def finish(loss: torch.Tensor, optimizer: torch.optim.Optimizer) -> None:
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()
        loss.item()

    def loop(batch: dict) -> None:
        seen, labels, actions = read_inputs(policy.config, batch), Labels.of(batch), read_actions(policy.config, batch)
        shifted = replace(seen, images=random_shift(seen.images, 4).contiguous())
        percept = model.encode(shifted, labels.history)
        goals = as_floats(labels.goal).contiguous()
        for k, (skill, optimizer) in enumerate(zip(model.skills.skills, skill_optimizers, strict=True)):
            rows = (labels.skill == k).nonzero()[:, 0]
            if len(rows):
                subgoal = skill.subgoal_encoder(goals[rows])
                subgoal = subgoal + 0.1 * torch.randn_like(subgoal)
                output = skill(percept.images[rows], subgoal, percept.told[rows])
                finish(model.actions.errors(output, actions[rows]).sum(), optimizer)
        target = model.skills.subgoal_targets(labels.skill, goals)
        situation = model.situation(percept, labels.held, labels.held_for, labels.finished)
        meta, _ = model.meta_controllers.losses(situation, labels.skill, target)
        finish((meta.skill_id_loss + meta.subgoal_loss + 1e-4 * meta.kl_loss).mean(), meta_optimizer)

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
    print(f"loader: {config.batch_size / loading:.0f} frames/s in {max(1, config.workers)} process(es)")
    # A skill's share of a batch differs from batch to batch, which can matter on a GPU.
    loaded = [next(stream) for _ in range(warm_ups(config.steps))]

    def on_loaded(make: Callable[[BudsPolicy, torch.optim.Optimizer], Callable[[dict], object]], **options: Any) -> Any:
        policy, optimizer = _buds(config, dataset, **options)
        prepare, _ = make_pre_post_processors(policy.config, dataset_stats=dataset.meta.stats)
        prepared = cycle([prepare(_chunked(batch, policy.config.chunk_size)) for batch in loaded])
        work = make(policy, optimizer)
        for _ in range(WATCHED if policy.config.cuda_graphs else 0):
            work(next(prepared))
        return lambda: work(next(prepared))

    def updating(policy: BudsPolicy, optimizer: torch.optim.Optimizer) -> Callable[[dict], object]:
        return partial(update, policy, optimizer, config.amp)

    works: dict[str, Callable[[], Callable[[], None]]] = {
        "buds": lambda: on_loaded(updating, compile_model=config.compiled, cuda_graphs=config.graphs),
        "the same, flat": lambda: on_loaded(updating, skills="flat"),
        "ACT with its defaults": lambda: _act(config, dataset),
    }
    if not config.policy.shared_trunk and config.policy.subgoal_space == "image":
        works["plain loop over separate networks"] = lambda: on_loaded(lambda policy, _: separate_networks(policy))
    works["buds, meta controller alone"] = lambda: _meta_controller_alone(config, dataset, on_loaded, updating)
    for name, build in works.items():
        if config.asks_for(name):
            torch.backends.cudnn.benchmark = torch.backends.cuda.matmul.allow_tf32 = True  # as lerobot-train sets them
            if config.device == "cuda":
                torch.cuda.reset_peak_memory_stats()
            seconds = median_seconds(build(), config.steps)
            memory = f", {torch.cuda.max_memory_allocated() / 2**30:.1f} GiB" if config.device == "cuda" else ""
            print(f"update, {name}: {seconds:.3f} s, {config.batch_size / seconds:.1f} frames/s{memory}", flush=True)


def _buds(config: BenchmarkConfig, dataset: LeRobotDataset, **options: Any) -> tuple[BudsPolicy, torch.optim.Optimizer]:
    """Builds the policy, and its optimiser."""
    settings = replace(deepcopy(config.policy), device=config.device, **options)
    return built(settings, dataset)


def _chunked(batch: dict, size: int) -> dict:
    """Repeats the action, as if the loader had been asked for chunks."""
    if size == 1:
        return batch
    return {**batch, ACTION: batch[ACTION][:, None].expand(-1, size, -1)}


def _meta_controller_alone(
    config: BenchmarkConfig, dataset: LeRobotDataset, on_loaded: Callable[..., Any], updating: Callable[..., Any]
) -> Callable[[], None]:
    """Skills of a library are frozen."""
    with TemporaryDirectory() as library:
        _buds(config, dataset)[0].save_pretrained(library)
        work: Callable[[], None] = on_loaded(updating, skills_path=library)
        return work


def _act(config: BenchmarkConfig, dataset: LeRobotDataset) -> Callable[[], None]:
    deltas = {ACTION: [i / dataset.fps for i in range(CHUNK)]}
    chunks = LeRobotDataset("local/benchmark", root=config.root, delta_timestamps=deltas)
    # Its weights for ImageNet cannot be fetched everywhere; they do not change the time.
    policy, optimizer = built(ACTConfig(device=config.device, pretrained_backbone_weights=None), dataset)
    prepare, _ = make_pre_post_processors(policy.config, dataset_stats=dataset.meta.stats)
    return partial(update, policy, optimizer, config.amp, prepare(next(batches(chunks, config))))


def _moved(batch: dict, device: torch.device) -> dict:
    return {key: value.to(device) if isinstance(value, torch.Tensor) else value for key, value in batch.items()}


def time_acting(config: BenchmarkConfig) -> None:
    """Prints how long `select_action` takes, for one environment and for several at once."""
    dataset = LeRobotDataset("local/benchmark", root=config.root)
    policy, _ = _buds(config, dataset, compile_model=config.compiled)
    policy.eval()
    frames = list(islice((_moved(dataset[i], torch.device(config.device)) for i in range(50)), 50))
    for environments, steps in ((1, config.actions), (config.environments, max(1, config.actions // 10))):
        seconds = []
        policy.reset()
        for step in range(WARM_UP + steps):
            frame = frames[step % len(frames)]
            batch = {k: v.expand(environments, *v.shape) for k, v in frame.items() if k in policy.config.input_features}
            began = time.perf_counter()
            policy.select_action({**batch, "task": [frame["task"]] * environments}).cpu()
            seconds.append(time.perf_counter() - began)
        p50, p99 = 1e3 * np.percentile(seconds[WARM_UP:], [50, 99]) / environments
        mean = 1e3 * np.mean(seconds[WARM_UP:]) / environments
        print(
            f"acting, {environments} at once: p50 {p50:.1f} ms, p99 {p99:.1f} ms, mean {mean:.1f} ms each", flush=True
        )


def main() -> None:
    """Prints all timings."""
    config = draccus.parse(BenchmarkConfig)
    torch.set_num_threads(config.threads)
    time_training(config)
    if config.asks_for("acting"):
        time_acting(config)
    print(f"peak memory of all that ran: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.1f} GiB")


if __name__ == "__main__":
    main()
