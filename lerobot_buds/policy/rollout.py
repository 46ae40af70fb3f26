"""How the policy goes on from step to step, for all environments of a batch together: decisions, plans, memory.

What falls due is counted on the CPU, whatever the device: to ask a GPU would be to wait for it at every step.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from .inputs import Observation
from .labels import UNDECIDED
from .meta_controller import SkillMemory
from .model import BudsModel, Percept

Override = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]
"""Decides in the place of the meta controller."""


@dataclass
class Rollout:
    """Decisions in force, what was done before, gripper readings and planned actions; built anew at every reset.

    Attributes:
        skill: ``(B,)`` int64 skill in force.
        subgoal: ``(B, d)`` subgoal in force.
        steps_left: ``(B,)`` int64 steps for which the decision still holds, on the CPU.
        held_for: ``(B,)`` int64 steps for which the skill has been in force.
        finished: ``(B, K)`` how often every skill had been done before it.
        previous: ``(B,)`` int64 skill that was in force before it, or `UNDECIDED`.
        previous_for: ``(B,)`` int64 steps for which that had been.
        history: ``(B, n, h)`` last n gripper readings, oldest first, without the current one.
        plan: ``(B, m, A)`` the next actions, in the unit of the dataset.
        planned: ``(B,)`` int64 how many of them are to be carried out, on the CPU.
    """

    skill: Tensor
    subgoal: Tensor
    steps_left: Tensor
    held_for: Tensor
    finished: Tensor
    previous: Tensor
    previous_for: Tensor
    history: Tensor
    plan: Tensor
    planned: Tensor

    @classmethod
    def start(cls, model: BudsModel, observation: Observation) -> "Rollout":
        """Begins a rollout: no decision yet, and a history of copies of the first reading (released code)."""
        config, reading = model.config, model.proprioception.reading(observation.state)
        batch, device = len(reading), reading.device
        none = torch.zeros(batch, dtype=torch.int64, device=device)
        nothing_left = torch.zeros(batch, dtype=torch.int64)
        return cls(
            skill=none + UNDECIDED if config.has_subgoals else none,
            subgoal=torch.zeros(batch, model.skills.subgoal_dim, device=device),
            steps_left=nothing_left,
            held_for=none,
            finished=torch.zeros(batch, config.n_skills or 1, device=device),
            previous=none + UNDECIDED,
            previous_for=none,
            history=reading[:, None].repeat(1, config.history_frames, 1),
            plan=torch.zeros(batch, config.chunk_size, int(config.action_feature.shape[0]), device=device),
            planned=nothing_left,
        )

    def step(
        self,
        model: BudsModel,
        observation: Observation,
        noise: Tensor | None = None,
        override: Override | None = None,
        together: bool = True,
    ) -> Tensor:
        """Runs one control step: decides and plans where that is due, and takes the next action of every plan.

        Args:
            model: The model.
            observation: What is seen and felt now.
            noise: ``(B, latent)`` for the subgoals; see `BudsPolicy.select_action`.
            override: Called at every decision with the ``(D,)`` int64 rows of the batch that decide together, their
                ``(D,)`` int64 skills and ``(D, d)`` subgoals; what it returns in the place of the last two is done.
            together: The networks take all rows at once. One by one is slower, and no row depends on any other: in
                batches of another size networks round otherwise, which is enough to part trajectories.

        Returns:
            ``(B, A)`` actions, in the unit of the dataset.
        """
        due = (self.steps_left == 0) if model.config.has_subgoals else torch.zeros_like(self.planned, dtype=torch.bool)
        rows = (due | (self.planned == 0)).nonzero()[:, 0]
        if len(rows):
            for some in torch.split(rows, len(rows) if together else 1):
                self._plan(model, observation, some, due[some], noise, override)
        return self._advance(model.proprioception.reading(observation.state))

    def _plan(
        self,
        model: BudsModel,
        observation: Observation,
        rows: Tensor,
        due: Tensor,
        noise: Tensor | None,
        override: Override | None,
    ) -> None:
        """Plans anew for some rows, after deciding for those whose decision is due, ``(R,)`` bool; both on the CPU."""
        self.planned = self.planned.index_fill(0, rows, model.config.n_action_steps)
        self.steps_left = self.steps_left.index_fill(0, rows[due], model.config.meta_period)
        rows = rows.to(self.skill.device, non_blocking=True)
        percept = model.encode(observation[rows], self.history[rows])
        if due.any():
            deciding = due.nonzero()[:, 0].to(rows.device, non_blocking=True)
            decided = self._decide(model, percept[deciding], rows[deciding], noise)
            if override is not None:
                decided = override(rows[deciding], *decided)
            self._hold(model, rows[deciding], *decided)
        actions = model.act(percept, self.skill[rows], self.subgoal[rows])
        self.plan = self.plan.index_copy(0, rows, actions.to(self.plan.dtype))

    def drop_plans(self) -> None:
        """Ends all decisions and plans here: the next step makes new ones. Memory and readings stay."""
        self.steps_left, self.planned = torch.zeros_like(self.steps_left), torch.zeros_like(self.planned)

    def foresee(
        self, model: BudsModel, observation: Observation, noise: Tensor | None = None, remembers: bool = True
    ) -> Tensor:
        """Computes what would be done if all decided now, ``(B, n, A)``, and changes nothing.

        Args:
            model: The model.
            observation: What is seen and felt now.
            noise: As for `step`.
            remembers: The memory counts.
        """
        rows = torch.arange(len(self.skill), device=self.skill.device)
        percept = model.encode(observation, self.history)
        skill, subgoal = self.skill, self.subgoal
        if model.config.has_subgoals:
            skill, subgoal = self._decide(model, percept, rows, noise, remembers)
        return model.act(percept, skill, subgoal)

    def _decide(
        self, model: BudsModel, percept: Percept, rows: Tensor, noise: Tensor | None, remembers: bool = True
    ) -> tuple[Tensor, Tensor]:
        """Asks the meta controllers of some rows for ``(D,)`` skills and ``(D, d)`` subgoals."""
        size = len(rows), model.config.meta_latent
        if not model.config.drawn_subgoals:
            drawn = percept.images.new_zeros(size)
        else:
            drawn = torch.randn(size) if noise is None else noise.to(rows.device)[rows]
        memory = self.skill[rows], self.held_for[rows], self.finished[rows]
        situation = model.situation(percept, *memory)
        if not remembers:
            situation = replace(situation, remembers=torch.zeros_like(situation.remembers))
        return model.decide(situation, drawn.to(percept.images))

    def _hold(self, model: BudsModel, rows: Tensor, skill: Tensor, subgoal: Tensor) -> None:
        """Puts new decisions of some rows into force."""
        self._remember(model.memory, rows, skill)
        # Not in place, here and below: a rollout may be carried in and out of torch's inference mode.
        self.skill = self.skill.index_copy(0, rows, skill)
        self.subgoal = self.subgoal.index_copy(0, rows, subgoal.to(self.subgoal.dtype))

    def _remember(self, memory: SkillMemory, rows: Tensor, skill: Tensor) -> None:
        """Counts what was done until now; a skill that was left for a moment only goes on as if it had not been."""
        before, held_for = self.skill[rows], self.held_for[rows]
        previous, previous_for = self.previous[rows], self.previous_for[rows]
        left = (skill != before) & (before >= 0)
        done = left & memory.counts(before, held_for)
        is_back = left & ~done & (skill == previous)
        finished = self.finished[rows]
        finished = finished.scatter_add(1, before.clamp(min=0)[:, None], done[:, None].to(finished))
        taken_back = is_back & memory.counts(previous, previous_for)
        finished = finished.scatter_add(1, skill[:, None], -taken_back[:, None].to(finished))
        since = torch.where(is_back, previous_for + held_for, torch.where(left, 0, held_for))
        self.finished = self.finished.index_copy(0, rows, finished)
        self.held_for = self.held_for.index_copy(0, rows, since)
        self.previous = self.previous.index_copy(0, rows, torch.where(left & ~is_back, before, previous))
        self.previous_for = self.previous_for.index_copy(0, rows, torch.where(left & ~is_back, held_for, previous_for))

    def _advance(self, reading: Tensor) -> Tensor:
        """Ends a step with a ``(B, h)`` gripper reading, and returns its ``(B, A)`` actions."""
        action = self.plan[:, 0]
        self.plan = self.plan.roll(-1, dims=1)
        self.planned = self.planned - 1
        self.history = torch.cat([self.history[:, 1:], reading[:, None]], dim=1)
        self.steps_left = self.steps_left - 1
        self.held_for = self.held_for + 1
        return action
