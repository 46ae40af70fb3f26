"""What the policy remembers between two steps of a rollout, for all environments of a batch together."""

from dataclasses import dataclass

import torch
from torch import Tensor

UNDECIDED = -1
"""Stands for a skill before the first decision."""


@dataclass
class Rollout:
    """Decisions in force, gripper readings and predictions so far; built anew at every reset.

    Attributes:
        skill: ``(B,)`` int64 skill in force.
        subgoal: ``(B, d)`` subgoal in force.
        steps_left: ``(B,)`` int64 steps for which the decision still holds.
        history: ``(B, n, h)`` last n gripper readings, oldest first, without the current one.
        plan: ``(B, m, A)`` mean of what the skill in force has predicted for the next m steps.
        votes: ``(B, m)`` int64 number of its predictions.
        ended: ``(B,)`` bool, whether the skill in force may be left.
    """

    skill: Tensor
    subgoal: Tensor
    steps_left: Tensor
    history: Tensor
    plan: Tensor
    votes: Tensor
    ended: Tensor

    @classmethod
    def start(
        cls, reading: Tensor, history_frames: int, subgoal_dim: int, chunk: tuple[int, int], skill: int = UNDECIDED
    ) -> "Rollout":
        """Begins a rollout: no decision yet, and a history of copies of the first reading (released code).

        Args:
            reading: ``(B, h)`` first gripper reading.
            history_frames: Length n of the history (frames).
            subgoal_dim: Width d of subgoals.
            chunk: Actions m that a skill predicts at once, and dimensions A of an action.
            skill: The skill in force before any decision.
        """
        batch, device = reading.shape[0], reading.device
        return cls(
            skill=torch.full((batch,), skill, dtype=torch.int64, device=device),
            subgoal=torch.zeros(batch, subgoal_dim, device=device),
            steps_left=torch.zeros(batch, dtype=torch.int64, device=device),
            history=reading[:, None].repeat(1, history_frames, 1),
            plan=torch.zeros(batch, *chunk, device=device),
            votes=torch.zeros(batch, chunk[0], dtype=torch.int64, device=device),
            ended=torch.ones(batch, dtype=torch.bool, device=device),
        )

    def decide(self, due: Tensor, skill: Tensor, subgoal: Tensor, period: int) -> None:
        """Puts new decisions into force; predictions of a skill that is left are forgotten.

        Args:
            due: ``(B,)`` bool, the environments that decide now.
            skill: ``(D,)`` int64 skills, one per environment that decides.
            subgoal: ``(D, d)`` their subgoals.
            period: Steps for which they hold.
        """
        # Not in place: a rollout may be carried in and out of torch's inference mode.
        before = self.skill
        self.skill = self.skill.masked_scatter(due, skill)
        self.subgoal = self.subgoal.masked_scatter(due[:, None], subgoal.to(self.subgoal.dtype))
        self.steps_left = self.steps_left.masked_fill(due, period)
        self.votes = self.votes.masked_fill((self.skill != before)[:, None], 0)

    def advance(self, reading: Tensor, actions: Tensor, ended: Tensor, decay: float) -> Tensor:
        """Ends a step: averages overlapping predictions, takes the present action, and counts down.

        Args:
            reading: ``(B, h)`` current gripper reading; the oldest one is dropped for it.
            actions: ``(B, m, A)`` what the skill in force predicts now.
            ended: ``(B,)`` bool, whether it may be left.
            decay: The i-th oldest prediction for a step weighs ``exp(-decay i)`` (Zhao et al. 2023, ACT).

        Returns:
            ``(B, A)`` actions of this step.
        """
        weights = torch.exp(-decay * torch.arange(actions.shape[1] + 1, device=actions.device))
        new = weights[self.votes]
        old = (weights.cumsum(0) - weights)[self.votes]
        share = (new / (new + old))[..., None]
        plan = torch.lerp(self.plan, actions.to(self.plan.dtype), share)
        self.plan = torch.cat([plan[:, 1:], torch.zeros_like(plan[:, :1])], dim=1)
        self.votes = torch.cat([self.votes[:, 1:] + 1, torch.zeros_like(self.votes[:, :1])], dim=1)
        self.history = torch.cat([self.history[:, 1:], reading[:, None]], dim=1)
        self.steps_left = self.steps_left - 1
        self.ended = ended
        return plan[:, 0]


def choose_skills(logits: Tensor, held: Tensor, ended: Tensor, margin: float) -> Tensor:
    """Picks the most probable skill, but keeps the one in force unless there is reason to leave it.

    Args:
        logits: ``(D, K)`` ratings.
        held: ``(D,)`` int64 skills in force, or `UNDECIDED`.
        ended: ``(D,)`` bool, whether they may be left.
        margin: By how much another skill must be more probable.

    Returns:
        ``(D,)`` int64 skills.
    """
    probability = logits.softmax(dim=1)
    best = probability.argmax(dim=1)
    present = held.clamp(min=0)
    gain = (probability.gather(1, best[:, None]) - probability.gather(1, present[:, None]))[:, 0]
    keep = (held != UNDECIDED) & (~ended | (gain < margin))
    return torch.where(keep, present, best)
