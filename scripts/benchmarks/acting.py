"""How long `select_action` takes, beside one pass of a ResNet-18 over the same images."""

import time
from collections.abc import Callable, Iterator
from itertools import cycle
from typing import Any

import numpy as np
import torch
from torch import Tensor

from lerobot_buds.policy.networks import lay_out, make_resnet_trunk

from .figures import Figure, Setting
from .synthetic import CAMERAS, make_skills
from .training import SKILLS, Data, built, preset

WARM_UP = 10  # steps that do not count
SEVERAL = 10  # environments at once
PASS = "one pass of a ResNet-18"

Frame = dict[str, Any]


def measure(setting: Setting) -> Iterator[Figure]:
    """Acts with untrained policies on recorded frames; the meta controllers decide at every fifth."""
    size = setting.size
    data = Data.of(setting, make_skills(setting.place / "acted_on", size.pixels, size.frames, SKILLS))
    frames = frames_of(data)
    yield from percentiles(PASS, _passes(frames, setting.device), setting)
    for name in ("buds", "buds_improved", "buds_cpu"):
        for environments in (1, SEVERAL):
            what = f"{name}.yaml" if environments == 1 else f"{name}.yaml, each of {environments}"
            if setting.asks_for(what):
                yield from percentiles(what, acts(data, name, frames, environments), setting, environments)


def frames_of(data: Data) -> list[Frame]:
    """Reads a second's frames, and lays them where the policy computes."""
    device = data.setting.device
    return [{k: _moved(v, device) for k, v in data.dataset[row].items()} for row in range(data.dataset.fps)]


def percentiles(what: str, work: Callable[[], Tensor], setting: Setting, shared_by: int = 1) -> Iterator[Figure]:
    """Times single steps (ms)."""
    seconds = []
    for _ in range(WARM_UP + max(1, setting.size.acts // shared_by)):
        began = time.perf_counter()
        work()
        seconds.append((time.perf_counter() - began) / shared_by)
    for rank in (50, 99):
        value = 1e3 * float(np.percentile(seconds[WARM_UP:], rank))
        yield Figure(f"{what}, p{rank}", value, "ms", "" if what == PASS else f"{PASS}, p{rank}")


def _passes(frames: list[Frame], device: str) -> Callable[[], Tensor]:
    """Runs the network that a skill of the paper has, with its kernels where they are fastest."""
    network = make_resnet_trunk(3 * len(CAMERAS), "batch", stages=4)[0].to(device).eval()
    lay_out(network, torch.channels_last)
    turn = cycle(frames)

    @torch.inference_mode()
    def look() -> Tensor:
        frame = next(turn)
        maps: Tensor = network(torch.cat([frame[camera] for camera in CAMERAS])[None])
        return maps.cpu()

    return look


def acts(data: Data, name: str, frames: list[Frame], environments: int) -> Callable[[], Tensor]:
    """Makes steps of a preset's `select_action`, for so many environments that see the same."""
    policy, _ = built(preset(name, data.setting.device), data.dataset)
    policy.eval()
    policy.reset()
    turn = cycle(frames)

    def act() -> Tensor:
        frame = next(turn)
        batch = {k: v.expand(environments, *v.shape) for k, v in frame.items() if k in policy.config.input_features}
        action: Tensor = policy.select_action({**batch, "task": [frame["task"]] * environments})
        return action.cpu()

    return act


def _moved(value: Any, device: str) -> Any:
    return value.to(device) if isinstance(value, Tensor) else value
