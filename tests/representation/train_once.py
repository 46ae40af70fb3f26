"""Trains one representation in this process, or in each of several: root, output folder, cache, settings as JSON."""

import json
import os
import sys
from pathlib import Path

import torch

from lerobot_buds.representation import RepresentationConfig, train_representation

torch.set_num_threads(1)
root, output, cache = map(Path, sys.argv[1:4])
trained = train_representation(root, RepresentationConfig(**json.loads(sys.argv[4])), output, cache)
processes = os.environ.get("WORLD_SIZE", "1")
sys.stdout.write(f"trained {os.environ.get('RANK', '0')} of {processes}: {trained.hash}\n")
