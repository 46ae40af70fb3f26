"""What the policy is timed against does the work of the original: every network is trained."""

import runpy
from pathlib import Path

import torch
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.policies import make_policy, make_pre_post_processors

from lerobot_buds.policy import BudsConfig

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "scripts/benchmark_policy.py"))
SMALL = {"encoder": "conv", "norm": "group", "conv_channels": [8, 8], "keypoints": 8, "head_widths": [32]}


def test_the_plain_loop_trains_the_meta_controllers_of_all_tasks(segmented: Path) -> None:
    meta = LeRobotDatasetMetadata("tests/x", root=segmented)
    tasks = [str(meta.tasks.index[0]), "Boil the pot"]
    policy = make_policy(BudsConfig(device="cpu", tasks=tasks, **SMALL), ds_meta=meta)
    prepare, _ = make_pre_post_processors(policy.config, dataset_stats=meta.stats)
    dataset = LeRobotDataset("tests/x", root=segmented)
    batch = prepare(torch.utils.data.default_collate([dataset[row] for row in range(4)]))
    heads = [controller.id_head[0].weight for controller in policy.model.meta_controllers.controllers]
    before = [head.detach().clone() for head in heads]
    SCRIPT["separate_networks"](policy)({**batch, "task": tasks * 2})
    assert not any(map(torch.equal, heads, before))


def test_a_part_of_its_name_picks_what_is_timed() -> None:
    config = SCRIPT["BenchmarkConfig"]("root", policy=BudsConfig(device="cpu"))
    assert config.asks_for("acting")
    config.only = "meta controller"
    assert config.asks_for("buds, meta controller alone") and not config.asks_for("acting")
