"""Which link of a policy is weak: errors of its actions on demonstrations, with each link replaced by the truth."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_buds.core import IntArray
from lerobot_buds.policy.labels import Labels
from lerobot_buds.policy.model import BudsModel, spread_within
from lerobot_buds.policy.modeling_buds import BudsPolicy
from lerobot_buds.policy.rollout import Override, Rollout

from .recorded import RecordedFrames

Mask = NDArray[np.bool_]
Errors = NDArray[np.float64]

DISTANCES_S = (0.25, 0.5, 1.0)
"""Bounds of the distances to the nearest boundary by which errors are listed (seconds)."""

NEAR_S = 0.5
"""Nearer to a boundary than this, right and wrong decisions are counted on their own (seconds)."""


@torch.no_grad()
def diagnose(policy: BudsPolicy, frames: RecordedFrames, episodes: IntArray, seed: int = 0) -> dict[str, Any]:
    """Lets a policy act along demonstrations, which stay on their course whatever it does.

    Args:
        policy: The policy.
        frames: The dataset.
        episodes: Numbers of the episodes, which the policy should not have been trained on.
        seed: Of the shuffle.

    Returns:
        Plain data. ``errors``: squared errors of the actions, summed over their dimensions, in the scale that is
        trained, as means over the frames, by who decides: ``chosen`` (as in a rollout), ``held`` (true skill and goal,
        at every decision), ``imagined`` (true skill, imagined subgoal), ``shuffled`` (true skill, goal of another frame
        of that skill); a flat policy has ``chosen`` alone. ``near``: the same within `DISTANCES_S` of a boundary.
        ``skill_ids``: the share of frames with the right skill, of all and of those within `NEAR_S` of a boundary, and
        ``switches`` an episode, with those of the demonstrations. ``subgoals``: squared errors of the imagined ones,
        and the spread within a skill, which they should be below.
    """
    policy.eval()
    model, fps = policy.model, policy.config.fps or 1.0
    rows, real = _lockstep(frames, episodes)
    chosen, skills = _act_along(model, frames, rows)
    if not policy.config.has_subgoals:
        return {"frames": int(real.sum()), "errors": {"chosen": _mean(chosen[real])}}
    truth = _Truth.of(model, frames, rows, torch.from_numpy(real), np.random.default_rng(seed))
    errors = {"chosen": chosen}
    for name, subgoals in (("imagined", truth.imagined), ("held", truth.exact), ("shuffled", truth.shuffled)):
        errors[name], _ = _act_along(model, frames, rows, truth.skills, subgoals)
    true_skills = truth.skills.cpu().numpy()
    distance = _to_boundary(true_skills, real)
    right = skills == true_skills
    return {
        "frames": int(real.sum()),
        "errors": {name: _mean(error[real]) for name, error in errors.items()},
        "near": {
            f"{seconds:g} s": {name: _mean(error[real & (distance < seconds * fps)]) for name, error in errors.items()}
            for seconds in DISTANCES_S
        },
        "skill_ids": {
            "right": _mean(right[real]),
            "right_near": _mean(right[real & (distance < NEAR_S * fps)]),
            "switches": _switches(skills, real),
            "switches_demonstrated": _switches(true_skills, real),
        },
        "subgoals": truth.subgoal_errors(torch.from_numpy(real)),
    }


def _lockstep(frames: RecordedFrames, episodes: IntArray) -> tuple[IntArray, Mask]:
    """Lays episodes side by side: ``(T, E)`` rows, the last one repeated, and ``(T, E)`` bool, which are real."""
    starts, ends = frames.starts[episodes], frames.ends[episodes]
    steps = np.arange((ends - starts).max())[:, None]
    return np.minimum(starts + steps, ends - 1), starts + steps < ends


def _act_along(
    model: BudsModel,
    frames: RecordedFrames,
    rows: IntArray,
    skills: Tensor | None = None,
    subgoals: Tensor | None = None,
) -> tuple[Errors, IntArray]:
    """Acts along all episodes at once, with given skills ``(T, E)`` and subgoals ``(T, E, d)`` or of its own choice.

    Returns:
        ``(T, E)`` squared errors, and the skills that were done.
    """
    rollout: Rollout | None = None
    errors, done = np.zeros(rows.shape), np.zeros(rows.shape, dtype=np.int64)
    for step, now in enumerate(rows):
        override: Override | None = None
        if skills is not None and subgoals is not None:
            override = partial(_given, skills[step], subgoals[step])
        observation = frames.observation(now)
        rollout = rollout or Rollout.start(model, observation)
        action = rollout.step(model, observation, override=override)
        demonstrated, _ = frames.actions(now)
        errors[step] = model.actions.distance(action, demonstrated[:, 0]).cpu().numpy()
        done[step] = rollout.skill.cpu().numpy()
    return errors, done


def _given(skills: Tensor, subgoals: Tensor, rows: Tensor, *_: Tensor) -> tuple[Tensor, Tensor]:
    return skills[rows], subgoals[rows]


@dataclass(frozen=True)
class _Truth:
    """What the labels say along all episodes: ``(T, E)`` skills, and ``(T, E, d)`` subgoals of three kinds."""

    skills: Tensor
    exact: Tensor
    imagined: Tensor
    shuffled: Tensor

    @classmethod
    def of(
        cls, model: BudsModel, frames: RecordedFrames, rows: IntArray, real: Tensor, rng: np.random.Generator
    ) -> "_Truth":
        skills, exact, imagined = [], [], []
        for now in rows:
            labels = frames.labels(now)
            skills.append(labels.skill)
            exact.append(model.encode_goals(labels.skill, labels.goal)[0])
            imagined.append(_imagine(model, frames, now, labels))
        stacked = torch.stack(skills), torch.stack(exact)
        return cls(*stacked, torch.stack(imagined), _shuffled(*stacked, real, rng))

    def subgoal_errors(self, real: Tensor) -> dict[str, float]:
        """Computes errors and spread over the real frames."""
        skills, exact = self.skills[real], self.exact[real]
        errors = (self.imagined[real] - exact).square().sum(dim=1)
        spread = spread_within(exact, skills, int(skills.max()) + 1)
        return {"imagined_error": round(float(errors.mean()), 4), "spread_within": round(float(spread.mean()), 4)}


def _imagine(model: BudsModel, frames: RecordedFrames, now: IntArray, labels: Labels) -> Tensor:
    """Imagines the subgoals of the true skills, ``(E, d)``."""
    assert model.meta_controllers is not None
    percept = model.encode(frames.observation(now), labels.history)
    situation = model.situation(percept, labels.held, labels.held_for, labels.finished)
    feature, _ = model.meta_controllers.propose(situation)
    latent = feature.new_zeros(len(feature), model.config.meta_latent)
    return model.meta_controllers.imagine(feature, percept.task, labels.skill, latent)


def _shuffled(skills: Tensor, subgoals: Tensor, real: Tensor, rng: np.random.Generator) -> Tensor:
    """Gives every real frame the subgoal of another one of the same skill."""
    ids, shuffled = skills.flatten(), subgoals.flatten(0, 1).clone()
    for skill in torch.unique(ids):
        rows = ((ids == skill) & real.flatten().to(ids.device)).nonzero()[:, 0]
        shuffled[rows] = shuffled[rows[torch.from_numpy(rng.permutation(len(rows))).to(rows.device)]]
    return shuffled.view_as(subgoals)


def _to_boundary(skills: IntArray, real: Mask) -> IntArray:
    """Counts the frames from every frame to the nearest boundary of its episode, ``(T, E)``; many where it has none."""
    steps = np.arange(len(skills))
    distance = np.full(skills.shape, np.iinfo(np.int64).max)
    for episode, (labels, is_real) in enumerate(zip(skills.T, real.T, strict=True)):
        bounds = np.flatnonzero(np.diff(labels[is_real])) + 1
        if len(bounds):
            distance[:, episode] = np.abs(steps[:, None] - bounds).min(axis=1)
    return distance


def _mean(values: NDArray[Any]) -> float | None:
    return round(float(np.mean(values)), 4) if values.size else None


def _switches(skills: IntArray, real: Mask) -> float:
    changes = (np.diff(skills, axis=0) != 0) & real[1:]
    return round(float(changes.sum(axis=0).mean()), 2)
