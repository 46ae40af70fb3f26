"""Compares the actions of a policy with the recorded ones, on the recorded observations, as parts of their range.

    python scripts/check_actions.py --policy=outputs/policy/checkpoints/last/pretrained_model \
        --repo_id=me/so101_skills --root=outputs/so101_skills --episodes 0 1 2

The policy acts as in a rollout, an episode at a time, but sees what the demonstrator saw. Small differences say that it
has learnt its data, not that it succeeds.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.datasets import LeRobotDataset
from numpy.typing import NDArray
from tqdm import tqdm

from lerobot_buds.policy.modeling_buds import BudsPolicy


@torch.inference_mode()
def acted(policy: BudsPolicy, dataset: LeRobotDataset, rows: range) -> NDArray[np.float64]:
    """Lets the policy act along recorded frames, ``(T, A)`` in the dataset's unit."""
    policy.reset()
    actions = []
    for row in tqdm(rows, leave=False):
        frame: dict[str, Any] = dataset[row]
        batch = {name: frame[name][None] for name in policy.config.input_features}
        actions.append(policy.select_action({**batch, "task": [frame["task"]]})[0].cpu().double().numpy())
    return np.stack(actions)


def main() -> None:
    """Prints the mean and the 95th percentile of the differences for every action."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", type=Path, required=True)
    parser.add_argument("--repo_id", required=True)
    parser.add_argument("--root", type=Path)
    parser.add_argument("--episodes", type=int, nargs="+", default=[0])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    dataset = LeRobotDataset(options.repo_id, root=options.root)
    policy = BudsPolicy.from_pretrained(options.policy)
    differences = []
    for number in options.episodes:
        record = dataset.meta.episodes[number]
        rows = range(record["dataset_from_index"], record["dataset_to_index"])
        recorded = np.stack([np.atleast_1d(row) for row in dataset.hf_dataset[rows.start : rows.stop]["action"]])
        differences.append(np.abs(acted(policy, dataset, rows) - recorded))
    stats = dataset.meta.stats["action"]
    spread = np.maximum(np.asarray(stats["max"]) - np.asarray(stats["min"]), 1e-9)
    parts = np.concatenate(differences) / spread
    names = dataset.meta.features["action"]["names"]
    table = {
        name: {"mean": round(float(parts[:, d].mean()), 4), "p95": round(float(np.quantile(parts[:, d], 0.95)), 4)}
        for d, name in enumerate(names)
    }
    for name, row in table.items():
        print(f"{name:24s} mean {100 * row['mean']:5.2f} %   95th percentile {100 * row['p95']:5.2f} % of the range")
    print(f"{'all':24s} mean {100 * parts.mean():5.2f} %   95th percentile {100 * np.quantile(parts, 0.95):5.2f} %")
    if options.json:
        options.json.write_text(
            json.dumps({"frames": len(parts), "mean": float(parts.mean()), "actions": table}, indent=2)
        )


if __name__ == "__main__":
    main()
