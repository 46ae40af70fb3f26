"""How fast the paper's representation is trained, and frames are encoded: in batches, one by one, and from videos."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path

import torch
from accelerate import Accelerator
from lerobot.datasets import LeRobotDataset

from lerobot_buds.data import LocalDataset
from lerobot_buds.representation import Modalities, Representation, RepresentationConfig, encode_dataset
from lerobot_buds.representation.feed import Feed
from lerobot_buds.representation.inputs import DatasetInputs
from lerobot_buds.representation.network import FusionNetwork
from lerobot_buds.representation.run import TrainingRun

from .figures import Figure, Setting, median_seconds, once
from .synthetic import CAMERAS, make_demonstrations

ALONE, SINGLE, FRAME_BY_FRAME = "network alone, one batch over and over", "one by one", "videos, frame by frame"
BATCHES = (32, 128)


def measure(setting: Setting) -> Iterator[Figure]:
    """Trains on videos and encodes them; the speed does not depend on what was learnt."""
    root, pixels = setting.place / "filmed", setting.size.pixels
    make_demonstrations(root, pixels, setting.size.frames, stages=4, video=True)
    dataset = LocalDataset(root)
    device = "cpu" if setting.device == "cpu" else "auto"
    config = RepresentationConfig(proprioception=[], image_size=pixels, batch_size=setting.batch, device=device)
    representation = Representation.untrained(Modalities.select(dataset, config), config)
    yield from _from_videos(root, representation, setting)  # leaves the frames in the store
    yield from _training(dataset, representation, setting)
    yield from _encoding(representation, setting)


def _training(dataset: LocalDataset, representation: Representation, setting: Setting) -> Iterator[Figure]:
    """Times steps as the command takes them, and the network on what is there already."""
    config, network = representation.config, representation.network
    assert isinstance(network, FusionNetwork)
    cpu = setting.device == "cpu"
    accelerator = Accelerator(cpu=cpu, mixed_precision="no" if cpu else "bf16")
    inputs = DatasetInputs(dataset, representation.modalities, config.side, setting.place / "store")
    feed = Feed(inputs, accelerator.device, again=True)
    run = TrainingRun(feed, config, network, accelerator, inputs.rows, inputs.rows[:0])
    numbers = count()
    fed = setting.batch / median_seconds(lambda: run.step(next(numbers)), setting.size.repeats)
    batch = next(run.batches)
    run.batches = iter(partial(dict, batch), None)
    alone = setting.batch / median_seconds(lambda: run.step(next(numbers)), setting.size.repeats)
    yield Figure(f"training, {ALONE}", alone, "frames/s")
    yield Figure("training, fed from the store", fed, "frames/s", f"training, {ALONE}")


def _encoding(representation: Representation, setting: Setting) -> Iterator[Figure]:
    """Encodes random images that lie on the device."""
    network = replace(representation).network.to(setting.device).eval()
    size = max(BATCHES) if setting.size.repeats > 1 else 8
    frames = {name: torch.rand(size, 3, *[setting.size.pixels] * 2, device=setting.device) for name in CAMERAS}

    @torch.inference_mode()
    def encode(batch: int) -> None:
        for start in range(0, size, batch):
            network.latents({name: images[start : start + batch] for name, images in frames.items()})

    for batch in (1, *BATCHES):
        rate = size / median_seconds(partial(encode, batch), setting.size.repeats)
        name, against = (SINGLE, "") if batch == 1 else (f"in batches of {batch}", f"encoding {SINGLE}")
        yield Figure(f"encoding {name}", rate, "frames/s", against)


def _from_videos(root: Path, representation: Representation, setting: Setting) -> Iterator[Figure]:
    """Goes from a dataset's videos to latents: as the command does, and frame by frame through LeRobotDataset."""
    network = representation.network
    stored = LeRobotDataset("local/synthetic", root=root)

    @torch.inference_mode()
    def frame_by_frame() -> None:
        for item in map(stored.__getitem__, range(len(stored))):
            network.latents({name: item[name][None].to(setting.device) for name in CAMERAS})

    network.to(setting.device)
    theirs = len(stored) / once(frame_by_frame)
    yield Figure(FRAME_BY_FRAME, theirs, "frames/s")
    encode = partial(encode_dataset, root, representation, cache_dir=setting.place / "store")
    for name in ("videos to latents", "latents from the store"):
        yield Figure(name, len(stored) / once(encode), "frames/s", FRAME_BY_FRAME)
    network.to(setting.device)
