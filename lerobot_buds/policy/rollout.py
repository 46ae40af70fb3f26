"""What the policy remembers between two steps of a rollout, for all environments of a batch together."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass
class Rollout:
    """Decisions in force and gripper readings so far; built anew at every reset.

    Attributes:
        skill: ``(B,)`` int64 skill in force.
        subgoal: ``(B, d)`` subgoal in force.
        steps_left: ``(B,)`` int64 steps for which the decision still holds.
        history: ``(B, n, h)`` last n gripper readings, oldest first, without the current one.
    """

    skill: Tensor
    subgoal: Tensor
    steps_left: Tensor
    history: Tensor

    @classmethod
    def start(cls, reading: Tensor, history_frames: int, subgoal_dim: int) -> "Rollout":
        """Begins a rollout: no decision yet, and a history of copies of the first reading (released code).

        Args:
            reading: ``(B, h)`` first gripper reading.
            history_frames: Length n of the history (frames).
            subgoal_dim: Width d of subgoals.
        """
        batch, device = reading.shape[0], reading.device
        return cls(
            skill=torch.zeros(batch, dtype=torch.int64, device=device),
            subgoal=torch.zeros(batch, subgoal_dim, device=device),
            steps_left=torch.zeros(batch, dtype=torch.int64, device=device),
            history=reading[:, None].repeat(1, history_frames, 1),
        )

    def decide(self, due: Tensor, skill: Tensor, subgoal: Tensor, period: int) -> None:
        """Puts new decisions into force.

        Args:
            due: ``(B,)`` bool, the environments that decide now.
            skill: ``(D,)`` int64 skills, one per environment that decides.
            subgoal: ``(D, d)`` their subgoals.
            period: Steps for which they hold.
        """
        # Not in place: a rollout may be carried in and out of torch's inference mode.
        self.skill = self.skill.masked_scatter(due, skill)
        self.subgoal = self.subgoal.masked_scatter(due[:, None], subgoal.to(self.subgoal.dtype))
        self.steps_left = self.steps_left.masked_fill(due, period)

    def advance(self, reading: Tensor) -> None:
        """Ends a step: drops the oldest gripper reading, appends the current one ``(B, h)``, counts down."""
        self.history = torch.cat([self.history[:, 1:], reading[:, None]], dim=1)
        self.steps_left = self.steps_left - 1
