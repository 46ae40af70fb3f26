"""2. Use the labels in training: does it help to know the skill and its goal?

    python examples/2_train_with_labels.py --root=outputs/serve_skills

Two small networks predict recorded actions, one from the state, one also from the skill and the state at its subgoal;
demonstrations that neither was trained on tell them apart. The policy of this package does it in earnest, with images:

    lerobot-train --policy="include configs/policy/buds_cpu.yaml" --dataset.repo_id=me/serve_skills --dataset.root=outputs/serve_skills --output_dir=outputs/serve_policy --steps=300 --num_workers=0
"""  # noqa: E501

import argparse
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from lerobot_buds.core import ACTION, STATE
from lerobot_buds.data import read_table
from lerobot_buds.segmentation import load_labels


def error(inputs: Tensor, actions: Tensor, held_out: Tensor, steps: int) -> float:
    """Trains a network; returns its squared error on what was held out, of actions of unit variance."""
    torch.manual_seed(0)
    inputs = (inputs - inputs.mean(0)) / (inputs.std(0) + 1e-3)
    net = nn.Sequential(nn.Linear(inputs.shape[1], 128), nn.ReLU(), nn.Linear(128, actions.shape[1]))
    optimizer = torch.optim.AdamW(net.parameters(), lr=2e-3, weight_decay=1e-2)
    for _ in range(steps):
        optimizer.zero_grad()
        nn.functional.mse_loss(net(inputs[~held_out]), actions[~held_out]).backward()
        optimizer.step()
    with torch.no_grad():
        return float(nn.functional.mse_loss(net(inputs[held_out]), actions[held_out]))


def main(arguments: list[str] | None = None) -> dict[str, float]:
    """Compares the two and prints their errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, required=True, help="folder of a segmented dataset")
    parser.add_argument("--steps", type=int, default=500, help="gradient steps of each network")
    chosen = parser.parse_args(arguments)

    record, skill, subgoal = load_labels(chosen.root)  # refuses labels that no longer belong to the dataset
    table = read_table(chosen.root, [STATE, ACTION])
    state, action = (torch.tensor(table.columns[name], dtype=torch.float32) for name in (STATE, ACTION))
    action = (action - action.mean(0)) / (action.std(0) + 1e-3)
    goal, one_hot = state[subgoal] - state, nn.functional.one_hot(torch.tensor(skill), record.n_skills)
    held_out = torch.zeros(len(state), dtype=torch.bool)
    for start, end in zip(table.starts[::4], table.ends[::4], strict=True):
        held_out[np.arange(start, end)] = True

    errors = {
        "state": error(state, action, held_out, chosen.steps),
        "state, skill and subgoal": error(torch.cat([state, one_hot, goal], 1), action, held_out, chosen.steps),
    }
    for name, value in errors.items():
        print(f"squared error of actions from {name}: {value:.3f}")
    return errors


if __name__ == "__main__":
    main()
