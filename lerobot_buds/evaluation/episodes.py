"""Runs episodes of a policy and notes what it decides and how far it comes. Imports torch and LeRobot on use."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import segments_of
from lerobot_buds.envs import EpisodeVectorEnv, Observation, Task

from .checkpoint import Checkpoint
from .guide import META_CONTROLLER, Advice, Guide
from .trace import Decision, Episode, StageProgress

if TYPE_CHECKING:
    from torch import Tensor

    from lerobot_buds.policy.modeling_buds import BudsPolicy

_NOISE_STREAM = 2
"""Parts an episode's noise from all else that is drawn from its seed; demonstrators use 1."""


class EpisodeRecorder:
    """Notes one episode while it runs.

    Args:
        task: The task.
        seed: Seed of the episode.
        keeps_pictures: Keeps what both cameras see, for a video.

    Attributes:
        seed: Seed of the episode.
        progress: Which stages are done.
        decisions: Decisions so far.
        pictures: ``(H, 2 W, 3)`` uint8 both cameras side by side, before every control step and at the end.
        ended: The episode is over.
    """

    def __init__(self, task: Task, seed: int, keeps_pictures: bool) -> None:
        self.seed = seed
        self.progress = StageProgress(task)
        self.decisions: list[Decision] = []
        self.pictures: list[NDArray[np.uint8]] = []
        self.ended = False
        self._keeps_pictures = keeps_pictures
        self._skills: list[int] = []
        self._success, self._error = False, ""
        self._noise = np.random.default_rng([seed, _NOISE_STREAM])

    @property
    def steps(self) -> int:
        """Control steps so far."""
        return len(self._skills)

    def draw_noise(self, size: int) -> NDArray[np.float32]:
        """Draws the meta controller's noise of one step, which depends on the seed alone, ``(size,)``."""
        return self._noise.standard_normal(size, dtype=np.float32)

    def decide(self, proposed: int, advice: Advice) -> None:
        """Notes a decision; nothing once the episode is over.

        Args:
            proposed: Skill that the meta controller chose.
            advice: What is done.
        """
        if not self.ended:
            self.decisions.append(Decision(self.steps, proposed, advice.skill, advice.foreign))

    def act(self, skill: int) -> None:
        """Notes the skill of a control step; nothing once the episode is over."""
        if not self.ended:
            self._skills.append(skill)

    def see(self, images: Sequence[NDArray[np.uint8]], info: dict[str, Any], ended: bool) -> None:
        """Notes what came of the last control step, or of the reset; nothing once the episode is over.

        Args:
            images: ``(H, W, 3)`` uint8 of every camera.
            info: The environment's own part of the vector environment's ``info``.
            ended: The episode is over now.
        """
        if self.ended:
            return
        self.progress.update(info["stages_done"], self.steps)
        self._success, self._error = bool(info["is_success"]), str(info["error"])
        self.ended = ended
        if self._keeps_pictures:
            self.pictures.append(np.concatenate(images, axis=1))

    def episode(self) -> Episode:
        """Returns what there is to keep."""
        skills = tuple(segments_of(np.array(self._skills, dtype=np.int64)))
        stages = tuple(self.progress.steps)
        return Episode(self.seed, self._success, self._error, skills, tuple(self.decisions), stages)


@dataclass(frozen=True)
class Decider:
    """Makes the decisions of a batch of rollouts and notes them, in the place of the meta controller or beside it.

    Attributes:
        policy: The policy.
        guide: Demonstrations to ask; without them the meta controller decides alone and is not judged.
        skills_from: One of `guide.SKILL_SOURCES`.
        subgoals_from: One of `guide.SUBGOAL_SOURCES`.
    """

    policy: "BudsPolicy"
    guide: Guide | None = None
    skills_from: str = META_CONTROLLER
    subgoals_from: str = META_CONTROLLER

    def decide(
        self,
        observation: Observation,
        recorders: Sequence[EpisodeRecorder],
        rows: "Tensor",
        skills: "Tensor",
        subgoals: "Tensor",
    ) -> tuple["Tensor", "Tensor"]:
        """Decides for the environments whose decision is due; for the arguments after two see `select_action`.

        Args:
            observation: Batch of observations of the vector environment.
            recorders: One an environment.
            rows: ``(D,)`` int64 environments that decide.
            skills: ``(D,)`` int64 skills that the meta controller chose.
            subgoals: ``(D, d)`` subgoals that it imagined.

        Returns:
            Skills and subgoals to be done.
        """
        import torch

        proposed = skills.tolist()
        advice = self._advice(observation, recorders, rows.cpu().numpy(), proposed)
        for row, choice, hint in zip(rows.tolist(), proposed, advice, strict=True):
            recorders[row].decide(choice, hint)
        done = torch.tensor([hint.skill for hint in advice], device=skills.device)
        return done, self._subgoals(advice, done, subgoals)

    def _advice(
        self,
        observation: Observation,
        recorders: Sequence[EpisodeRecorder],
        rows: NDArray[np.int64],
        proposed: Sequence[int],
    ) -> list[Advice]:
        guide = self.guide
        if guide is None:
            return [Advice(skill) for skill in proposed]
        return [
            guide.advise(latent, skill, recorders[row].progress.possible, self.skills_from, self.subgoals_from)
            for row, skill, latent in zip(rows, proposed, guide.latents(observation, rows), strict=True)
        ]

    def _subgoals(self, advice: Sequence[Advice], skills: "Tensor", subgoals: "Tensor") -> "Tensor":
        """Puts the encoded goal frames of demonstrations in the place of what the meta controller imagined."""
        import torch

        goals = {i: hint.goal for i, hint in enumerate(advice) if hint.goal is not None}
        if self.guide is None or not goals:
            return subgoals
        frames = torch.from_numpy(self.guide.goals[list(goals.values())]).to(subgoals.device)
        subgoals = subgoals.clone()
        subgoals[list(goals)], _ = self.policy.model.encode_goals(skills[list(goals)], frames)
        return subgoals


def run_episodes(
    envs: EpisodeVectorEnv,
    checkpoint: Checkpoint,
    decider: Decider,
    recorders: Sequence[EpisodeRecorder],
    on_end: Callable[[], object],
) -> None:
    """Runs one episode in every environment, all at once.

    Args:
        envs: The environments.
        checkpoint: The policy.
        decider: Makes its decisions.
        recorders: One an environment, which bring the seeds; filled.
        on_end: Called whenever an episode is over.

    Raises:
        SimulatorError: Not a single environment could start.
        CheckpointError: The policy or the demonstrations do not fit the observations.
    """
    checkpoint.policy.reset()
    observation, info = envs.reset(seed=[recorder.seed for recorder in recorders])
    ended = info["error"] != ""
    while True:
        for i, recorder in enumerate(recorders):
            running = not recorder.ended
            images = [camera[i] for camera in observation["pixels"].values()]
            recorder.see(images, {name: values[i] for name, values in info.items()}, bool(ended[i]))
            if running and recorder.ended:
                on_end()
        if ended.all():
            return
        actions = _act(envs, checkpoint, decider, recorders, observation)
        observation, _, terminated, truncated, info = envs.step(actions)
        ended = terminated | truncated


def _act(
    envs: EpisodeVectorEnv,
    checkpoint: Checkpoint,
    decider: Decider,
    recorders: Sequence[EpisodeRecorder],
    observation: Observation,
) -> NDArray[np.float32]:
    import torch
    from lerobot.envs import preprocess_observation

    policy = checkpoint.policy
    batch = preprocess_observation(observation) | {"task": list(envs.call("task_description"))}
    noise = np.stack([recorder.draw_noise(policy.config.meta_latent) for recorder in recorders])
    with torch.inference_mode():
        action = policy.select_action(
            checkpoint.preprocess(batch),
            noise=torch.from_numpy(noise),
            override=partial(decider.decide, observation, recorders),
        )
        actions: NDArray[np.float32] = checkpoint.postprocess(action).cpu().numpy()
    skills = policy.current_skills
    assert skills is not None
    for recorder, skill in zip(recorders, skills.tolist(), strict=True):
        recorder.act(skill)
    return actions
