"""Trains and encodes in this process, or in each of several: root, output folder, cache, settings as JSON."""

import json
import os
import sys
from hashlib import sha256
from pathlib import Path

import numpy as np
import torch

from lerobot_buds.representation import RepresentationConfig, encode_dataset, leave_processes, train_representation

torch.set_num_threads(1)
root, output, cache = map(Path, sys.argv[1:4])
trained = train_representation(root, RepresentationConfig(**json.loads(sys.argv[4])), output, cache)
processes = os.environ.get("WORLD_SIZE", "1")
sys.stdout.write(f"trained {os.environ.get('RANK', '0')} of {processes}: {trained.hash}\n")

batches, encode = [], trained.network.latents


def counted(batch: dict[str, torch.Tensor]) -> torch.Tensor:
    """Counts the batches of this process."""
    batches.append(len(next(iter(batch.values()))))
    return encode(batch)


trained.network.latents = counted  # type: ignore[method-assign]
latents = np.concatenate(encode_dataset(root, trained, 8, output.with_name(f"{output.name}_latents")))
sys.stdout.write(f"encoded {len(batches)} batches of {sha256(latents.tobytes()).hexdigest()}\n")
leave_processes()
