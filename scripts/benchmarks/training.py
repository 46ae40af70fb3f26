"""How long an update takes: `buds` in its presets, a plain loop over the paper's networks, a flat policy, ACT."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import draccus
import torch
import yaml
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

from .figures import Figure, Setting, median_seconds
from .synthetic import make_skills

SKILLS = 5
LOOP, SMALL_FLAT = "plain loop over the paper's networks", "buds_cpu.yaml, flat"
SMALL_PIXELS = 64
ACT_CHUNK = 100  # its default
PRESETS = Path(__file__).parents[2] / "configs/policy"

Work = Callable[[], object]


@dataclass(frozen=True)
class Data:
    """What all policies are trained on.

    Attributes:
        setting: What the benchmark was told.
        dataset: Skills to learn.
        batches: Some loaded batches: a skill's share differs from batch to batch, which can matter on a GPU.
    """

    setting: Setting
    dataset: LeRobotDataset
    batches: list[dict[str, Any]]

    @classmethod
    def of(cls, setting: Setting, root: Path) -> "Data":
        """Loads a few batches of a segmented dataset."""
        dataset = LeRobotDataset("local/benchmark", root=root)
        order = torch.Generator().manual_seed(0)
        loader = torch.utils.data.DataLoader(dataset, setting.batch, shuffle=True, drop_last=True, generator=order)
        return cls(setting, dataset, list(islice(cycle(loader), 4)))


def measure(setting: Setting) -> Iterator[Figure]:
    """Times what ``lerobot-train`` does with a batch, and what the original does with it."""
    data = Data.of(setting, make_skills(setting.place / "taught", setting.size.pixels, setting.size.frames, SKILLS))
    small = _small(setting)
    for name, against, build in (*_works(data), *_small_works(small)):
        if not setting.asks_for(name):
            continue
        torch.backends.cudnn.benchmark = torch.backends.cuda.matmul.allow_tf32 = True  # as lerobot-train sets them
        if setting.device == "cuda":
            torch.cuda.reset_peak_memory_stats()
        repeats = setting.size.repeats * (1 if name.startswith(("plain", "ACT")) else 4)  # those take seconds
        yield Figure(name, median_seconds(build(), repeats), "s", against)
        if setting.device == "cuda":
            yield Figure(f"memory of {name}", torch.cuda.max_memory_allocated() / 2**30, "GiB")


def _works(data: Data) -> Iterator[tuple[str, str, Callable[[], Work]]]:
    """Names what is timed, what it is compared with, and how it is built."""
    yield LOOP, "", partial(plain_loop, data)
    yield "ACT with its defaults", LOOP, partial(_act, data)
    yield "buds.yaml", LOOP, partial(updates, data, "buds")
    yield "buds.yaml, norm=group", LOOP, partial(updates, data, "buds", norm="group")
    yield "buds.yaml, meta controller alone", LOOP, partial(_meta_controller_alone, data)
    yield "buds_improved.yaml", LOOP, partial(updates, data, "buds_improved")
    yield "bc.yaml", LOOP, partial(updates, data, "bc")
    if data.setting.device == "cuda":
        yield "buds.yaml, norm=group, graphs", LOOP, partial(updates, data, "buds", norm="group", cuda_graphs=True)
        yield "buds_improved.yaml, graphs", LOOP, partial(updates, data, "buds_improved", cuda_graphs=True)


def _small(setting: Setting) -> Data:
    """What the CPU preset is made for: 64 pixels, and batches of twice as many."""
    setting = replace(setting, batch=2 * setting.batch)
    return Data.of(setting, make_skills(setting.place / "taught_small", SMALL_PIXELS, setting.size.frames, SKILLS))


def _small_works(data: Data) -> Iterator[tuple[str, str, Callable[[], Work]]]:
    yield SMALL_FLAT, "", partial(updates, data, "buds_cpu", skills="flat", subgoal_space="image")
    yield "buds_cpu.yaml", SMALL_FLAT, partial(updates, data, "buds_cpu")


def preset(name: str, device: str, **changes: Any) -> BudsConfig:
    """Reads a file of ``configs/policy``."""
    told = yaml.safe_load((PRESETS / f"{name}.yaml").read_text())
    del told["type"]
    return replace(draccus.decode(BudsConfig, told), device=device, **changes)


def built(settings: PreTrainedConfig, dataset: LeRobotDataset) -> tuple[PreTrainedPolicy, torch.optim.Optimizer]:
    """Builds a policy and its optimiser through LeRobot's factory."""
    torch.manual_seed(0)
    policy = make_policy(settings, ds_meta=dataset.meta)
    return policy, settings.get_optimizer_preset().build(policy.get_optim_params())


def updates(data: Data, name: str, **changes: Any) -> Work:
    """Makes updates of a preset, on one batch after the other."""
    policy, optimizer = built(preset(name, data.setting.device, **changes), data.dataset)
    prepared = _prepared(data, policy)
    for _ in range(WATCHED if policy.config.cuda_graphs else 0):
        update(policy, optimizer, next(prepared))
    return lambda: update(policy, optimizer, next(prepared))


def update(policy: PreTrainedPolicy, optimizer: torch.optim.Optimizer, batch: dict[str, Any]) -> None:
    """Does what ``lerobot-train`` does with a batch."""
    policy.train()
    loss, _ = policy.forward(batch)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(policy.parameters(), 10.0)
    optimizer.step()
    optimizer.zero_grad()
    loss.item()


def _prepared(data: Data, policy: PreTrainedPolicy) -> Iterator[dict[str, Any]]:
    """Prepares the batches over and over; their actions are repeated as if the loader had been asked for chunks."""
    prepare, _ = make_pre_post_processors(policy.config, dataset_stats=data.dataset.meta.stats)
    for batch in cycle(data.batches):
        size = policy.config.chunk_size
        actions = batch[ACTION] if size == 1 else batch[ACTION][:, None].expand(-1, size, -1)
        yield prepare({**batch, ACTION: actions})


def plain_loop(data: Data) -> Work:
    """Makes updates of separate networks, of the paper's sizes."""
    policy, _ = built(preset("buds", data.setting.device), data.dataset)
    loop, prepared = separate_networks(policy), _prepared(data, policy)
    return lambda: loop(next(prepared))


def separate_networks(policy: BudsPolicy) -> Callable[[dict[str, Any]], None]:
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

    def loop(batch: dict[str, Any]) -> None:
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


def _meta_controller_alone(data: Data) -> Work:
    """Skills of a library are frozen."""
    library = data.setting.place / "library"
    built(preset("buds", data.setting.device), data.dataset)[0].save_pretrained(library)
    return updates(data, "buds", skills_path=str(library))


def _act(data: Data) -> Work:
    deltas = {ACTION: [step / data.dataset.fps for step in range(ACT_CHUNK)]}
    chunks = LeRobotDataset("local/benchmark", root=data.dataset.root, delta_timestamps=deltas)
    batch = next(iter(torch.utils.data.DataLoader(chunks, data.setting.batch, shuffle=True)))
    # Its weights for ImageNet cannot be fetched everywhere; they do not change the time.
    config = ACTConfig(device=data.setting.device, pretrained_backbone_weights=None)
    policy, optimizer = built(config, data.dataset)
    prepare, _ = make_pre_post_processors(policy.config, dataset_stats=data.dataset.meta.stats)
    return partial(update, policy, optimizer, prepare(batch))
