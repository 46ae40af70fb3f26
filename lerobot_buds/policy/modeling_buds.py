"""Policy type ``buds``: K skills and meta controllers, trained in one run and rolled out at two rates."""

import threading
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, Self

import torch
import torch.nn.functional as F
from lerobot.policies import PreTrainedPolicy
from torch import Tensor, nn

from lerobot_buds.core import ACTION, STATE, CheckpointError, DatasetError
from lerobot_buds.data import scale_images

from .configuration_buds import BudsConfig
from .images import lay_out, random_shift
from .labels import LabelTable, Supervision
from .meta_controller import MetaControllers, MetaLosses
from .proprioception import Proprioception
from .reuse import TrainedSkills
from .rollout import Rollout, choose_skills
from .settling import check_observation, settle_on_dataset, settle_without_dataset, task_number
from .skills import SkillLibrary
from .targets import TargetTable

Override = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]


class BudsPolicy(PreTrainedPolicy):  # type: ignore[misc]
    """Skills that pursue subgoals, and the meta controllers that pick skill and subgoal (paper).

    The released code trains skills first and the meta controller on the finished subgoal encoders; one run with
    ``schedule="sequential"`` does the same. With ``"joint"`` the meta controller's targets are the encoders' current
    outputs, without gradient, so that it follows them.

    Args:
        config: The configuration; fields it leaves open are filled in place.
        dataset_stats: LeRobot's statistics of the dataset.
        dataset_meta: LeRobot's metadata of the dataset to train on; without it the policy can only act.
        from_checkpoint: Weights will be loaded, so that those of a skill library are not wanted.
        kwargs: Whatever else LeRobot's factory hands to constructors; not used.

    Raises:
        ConfigError: The configuration cannot work with the features.
        SegmentationError: The dataset has no valid labels.
        CheckpointError: The checkpoint or the skill library does not fit the dataset.
    """

    config_class = BudsConfig
    name = "buds"
    trained_steps: Tensor

    def __init__(
        self,
        config: BudsConfig,
        dataset_stats: dict[str, dict[str, Any]] | None = None,
        dataset_meta: Any = None,
        from_checkpoint: bool = False,
        **kwargs: Any,
    ) -> None:
        super().__init__(config)
        self.config: BudsConfig = config
        taken = None
        if config.skills_path is not None and not from_checkpoint:
            taken = TrainedSkills.read(config.skills_path)
            taken.adopt(config)
        config.validate_features()
        if dataset_meta is None:
            settle_without_dataset(config)
        else:
            settle_on_dataset(config, dataset_meta)
        self.proprioception = Proprioception(config, dataset_stats)
        self.skills = SkillLibrary(config)
        self.meta_controllers = MetaControllers(config) if config.has_subgoals else None
        self.register_buffer("trained_steps", torch.zeros((), dtype=torch.int64))
        if taken is not None:
            taken.load_into(self)
        self.skills.requires_grad_(config.skills_path is None)
        if config.compile_model:
            self._compile_encoders()
        self._dataset_root = Path(dataset_meta.root) if dataset_meta is not None else None
        self._labels: LabelTable | None = None
        self._targets: TargetTable | None = None
        self._rollouts: dict[int, Rollout] = {}
        self._laid_out_for_acting = False

    @classmethod
    def from_pretrained(cls, pretrained_name_or_path: str | Path, **kwargs: Any) -> Self:
        """Reads a checkpoint, see LeRobot's method of the same name; frozen skills are part of it."""
        policy: Self = super().from_pretrained(pretrained_name_or_path, from_checkpoint=True, **kwargs)
        return policy

    def get_optim_params(self) -> list[dict[str, Any]]:
        """Returns one named parameter group for what is trained of skills and meta controllers each."""
        parts: dict[str, nn.Module | None] = {"skills": self.skills, "meta_controllers": self.meta_controllers}
        trained = {
            name: [p for p in part.parameters() if p.requires_grad] for name, part in parts.items() if part is not None
        }
        return [{"name": name, "params": params} for name, params in trained.items() if params]

    def train(self, mode: bool = True) -> Self:
        """Switches to training, in which skills that are not trained now keep their batch statistics."""
        super().train(mode)
        if mode:
            self._lay_out_for_acting(False)
        if mode and not self._learns_skills:
            self.skills.eval()
        return self

    def update(self) -> None:
        """Counts a training step; LeRobot calls it after each."""
        self.trained_steps += 1

    def forward(self, batch: dict[str, Any], reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """Computes the training loss; every term is a mean over the batch, so the batch size does not weigh them.

        Args:
            batch: LeRobot's batch: the inputs, ``action`` ``(B, A)`` or ``(B, n, A)``, and ``index`` ``(B,)``, the
                absolute frames.
            reduction: ``"mean"``, or ``"none"`` for the loss of every sample, as LeRobot's weighting asks for.

        Returns:
            The loss (scalar, or ``(B,)``), and its terms and the accuracy of the skill ids, the same keys at every
            step; parts that are not trained now count as 0.

        Raises:
            CheckpointError: An input is missing or has another shape than the policy was made for.
            ConfigError: A task is unknown.
        """
        images, state, task = self._inputs(batch)
        labels = self._label_table().lookup(batch["index"])
        if (goals := self._label_table().goals) is not None:
            goals.recognise(batch["index"], batch[self.config.cameras[0]])
        if self.training:
            images = random_shift(images, self.config.crop_padding)
        subgoal = target = imagined = images.new_zeros(len(images), 0)
        loss = torch.zeros(len(images), device=images.device)
        terms = dict.fromkeys(self._terms(), loss)
        learns_skills = self._learns_skills or not self.training
        if learns_skills and self.meta_controllers is not None:
            subgoal, target = self._encoded_goals(labels)
        if self.meta_controllers is not None and (self._learns_meta or not self.training):
            if not target.shape[1]:
                target = self._kept_targets(batch["index"], labels)
            meta, imagined = self.meta_controllers.losses(self._seen_by_meta(images), task, labels.skill, target)
            terms |= vars(meta)
            loss = loss + meta.skill_id_loss + meta.subgoal_loss + self.config.kl_weight * meta.kl_loss
        if learns_skills:
            if self.training:
                subgoal = self._as_in_rollouts(subgoal, imagined)
            terms |= self._skill_terms(batch, labels, images, state, subgoal)
            loss = loss + sum(terms[name] for name in ("skill_loss", "termination_loss") if name in terms)
        means = torch.stack([term.detach().float().mean() for term in terms.values()]).tolist()
        return loss if reduction == "none" else loss.mean(), dict(zip(terms, means, strict=True))

    def _terms(self) -> list[str]:
        skills = ["skill_loss", *(["termination_loss"] if self.config.termination else [])]
        meta = [field.name for field in fields(MetaLosses)]
        return skills + meta if self.meta_controllers is not None else skills

    def _skill_terms(
        self, batch: dict[str, Any], labels: Supervision, images: Tensor, state: Tensor, subgoal: Tensor
    ) -> dict[str, Tensor]:
        """Computes the skills' terms of the loss, ``(B,)`` each."""
        proprio = self.proprioception(state, labels.history)
        predicted, ending = self.skills(labels.skill, images, subgoal, proprio)
        wanted = batch[ACTION] if self.config.chunk_size > 1 else batch[ACTION][:, None]
        errors = (predicted - wanted).square().sum(dim=2)  # (B, n)
        padded = batch.get("action_is_pad")
        inside = torch.ones_like(errors) if padded is None else (~padded).to(errors)
        weight = self._label_table().weights.to(errors)[labels.skill] if self.config.balance_skills else 1.0
        terms = {"skill_loss": weight * (errors * inside).sum(dim=1) / inside.sum(dim=1)}
        if self.config.termination:
            losses = F.binary_cross_entropy_with_logits(ending, labels.ending.to(ending), reduction="none")
            terms["termination_loss"] = weight * losses
        return terms

    def _as_in_rollouts(self, subgoal: Tensor, imagined: Tensor) -> Tensor:
        """Disturbs subgoals for training: some rows get what the meta controllers imagine, all get noise."""
        if self.config.imagined_subgoals and imagined.shape[1]:
            replaced = torch.rand(len(subgoal), 1, device=subgoal.device) < self.config.imagined_subgoals
            subgoal = torch.where(replaced, imagined.to(subgoal), subgoal)
        return subgoal + self.config.subgoal_noise * torch.randn_like(subgoal)

    def _encoded_goals(self, labels: Supervision) -> tuple[Tensor, Tensor]:
        """Encodes the goals of a batch for the skills, and for the meta controllers: without batch statistics."""
        goals = self._goal_images(labels.subgoal, labels.skill.device)
        subgoal = self.skills.encode_subgoals(labels.skill, goals)
        if self.training and self._learns_meta and self.skills.uses_batch_statistics:
            return subgoal, self.skills.subgoal_targets(labels.skill, goals)
        return subgoal, subgoal.detach()

    def _kept_targets(self, index: Tensor, labels: Supervision) -> Tensor:
        """Looks up the goals of a batch as skills that do not change encode them."""
        if self._targets is None:
            frames = len(self._label_table().skill)
            self._targets = TargetTable(frames, self.config.subgoal_dim, labels.skill.device)

        def compute(rows: Tensor) -> Tensor:
            goals = self._goal_images(labels.subgoal[rows.cpu()], labels.skill.device)
            return self.skills.subgoal_targets(labels.skill[rows], goals)

        return self._targets.lookup(index, compute)

    @property
    def _learns_skills(self) -> bool:
        if self.config.skills_path is not None:
            return False
        if self.config.schedule == "joint" or self.meta_controllers is None:
            return True
        return int(self.trained_steps) < (self.config.skill_steps or 0)

    @property
    def _learns_meta(self) -> bool:
        return self.config.schedule == "joint" or not self._learns_skills

    def reset(self) -> None:
        """Forgets the calling thread's rollout; LeRobot may evaluate several tasks in threads that share the policy."""
        self._rollouts.pop(threading.get_ident(), None)

    @torch.no_grad()
    def select_action(
        self, batch: dict[str, Any], noise: Tensor | None = None, override: Override | None = None, **kwargs: Any
    ) -> Tensor:
        """Runs one control step of all environments of a batch.

        Args:
            batch: The inputs, and ``task`` strings where there are several tasks.
            noise: ``(B, latent)`` standard normal numbers for the subgoals that are decided now, with
                `drawn_subgoals`; drawn from torch's default generator (CPU) where not given, and only in steps with a
                decision.
            override: Called at every decision with the ``(D,)`` int64 rows of the batch that decide now, their ``(D,)``
                int64 skills and ``(D, subgoal_dim)`` subgoals; what it returns in the place of the last two is done.
            kwargs: Not used.

        Returns:
            ``(B, A)`` actions in [-1, 1].

        Raises:
            CheckpointError: An input is missing or has another shape than the policy was made for.
            ConfigError: A task is unknown.
        """
        if self.training:
            self.eval()
        self._lay_out_for_acting(True)
        images, state, task = self._inputs(batch)
        reading = self.proprioception.reading(state)
        rollout = self._rollouts.get(threading.get_ident())
        if rollout is None or len(rollout.skill) != len(images):
            rollout = self._start(reading)
            self._rollouts[threading.get_ident()] = rollout
        due = rollout.steps_left == 0
        if self.meta_controllers is not None and due.any():
            rows = due.nonzero()[:, 0]
            skill, subgoal = self._decide(rollout, rows, images, task, noise)
            if override is not None:
                skill, subgoal = override(rows, skill, subgoal)
            rollout.decide(due, skill, subgoal, self.config.meta_period)
        proprio = self.proprioception(state, rollout.history)
        actions, ending = self.skills(rollout.skill, images, rollout.subgoal, proprio)
        ended = ending > 0 if self.config.termination else torch.ones_like(due)
        return rollout.advance(reading, actions, ended, self.config.ensemble_decay)

    def _lay_out_for_acting(self, acting: bool) -> None:
        # Not before the first action: optimisers and data parallelism take the order in which they find the weights.
        if acting != self._laid_out_for_acting:
            lay_out(self, torch.channels_last if acting else torch.contiguous_format)
            self._laid_out_for_acting = acting

    def _start(self, reading: Tensor) -> Rollout:
        config = self.config
        chunk = config.chunk_size, int(config.action_feature.shape[0])
        if config.has_subgoals:
            return Rollout.start(reading, config.history_frames, config.subgoal_dim, chunk)
        return Rollout.start(reading, config.history_frames, 0, chunk, skill=0)

    def _decide(
        self, rollout: Rollout, rows: Tensor, images: Tensor, task: Tensor, noise: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """Asks the meta controllers of some rows for ``(D,)`` skills and ``(D, subgoal_dim)`` subgoals."""
        assert self.meta_controllers is not None
        if not self.config.drawn_subgoals:
            noise = torch.zeros(len(images), self.config.meta_latent)
        elif noise is None:
            noise = torch.randn(len(images), self.config.meta_latent)
        feature, logits = self.meta_controllers.propose(self._seen_by_meta(images)[rows], task[rows])
        skill = choose_skills(logits, rollout.skill[rows], rollout.ended[rows], self.config.switch_margin)
        return skill, self.meta_controllers.imagine(feature, task[rows], skill, noise.to(images)[rows])

    def predict_action_chunk(self, batch: dict[str, Any], **kwargs: Any) -> Tensor:
        """Runs one control step and returns its action as a chunk of length 1, ``(B, 1, A)``."""
        return self.select_action(batch, **kwargs).unsqueeze(1)

    @property
    def current_skills(self) -> Tensor | None:
        """Skill in force in every environment of the calling thread's rollout, ``(B,)`` int64; None after a reset."""
        rollout = self._rollouts.get(threading.get_ident())
        return None if rollout is None else rollout.skill

    def __getstate__(self) -> dict[str, Any]:
        """Leaves tables and rollouts out of copies: they belong to one process, and are rebuilt when needed."""
        return {**self.__dict__, "_labels": None, "_targets": None, "_rollouts": {}}

    def _label_table(self) -> LabelTable:
        if self._labels is None:
            if self._dataset_root is None:
                raise DatasetError("This policy was built without a dataset: it can act, but not compute a loss.")
            self._labels = LabelTable(self._dataset_root, self.config)
        return self._labels

    def _goal_images(self, frames: Tensor, device: torch.device) -> Tensor:
        goals = self._label_table().goals
        assert goals is not None  # nobody asks where there are no subgoals
        return goals.images(frames.numpy(), device)

    def _compile_encoders(self) -> None:
        names = {"image_encoder", "subgoal_encoder", "image_trunk", "goal_trunk"}
        encoders = [module for name, module in self.named_modules() if name.rpartition(".")[2] in names]
        # All run the same line of code, and what is compiled too often (for gradients or not, for a single row, ...)
        # falls back to what it was.
        limit = torch.compiler.config.recompile_limit
        torch.compiler.config.recompile_limit = max(limit, 4 * len(encoders))
        for encoder in encoders:
            encoder.compile(dynamic=True)  # a skill's share of a batch changes from step to step

    def _inputs(self, batch: dict[str, Any]) -> tuple[Tensor, Tensor, Tensor]:
        """Checks a batch; returns images ``(B, C, H, W)`` of network size, state ``(B, D)`` and tasks ``(B,)``."""
        missing = [key for key in self.config.input_features if key not in batch]
        if missing:
            known = sorted(key for key in batch if key.startswith("observation"))
            raise CheckpointError(f"The policy needs {missing}, which the observation lacks. It has {known}.")
        for key, feature in self.config.input_features.items():
            expected, given = tuple(feature.shape), tuple(batch[key].shape[1:])
            if expected != given:
                raise CheckpointError(f"{key}: the policy was made for shape {expected}, the observation has {given}.")
        check_observation(self.config, batch)
        scaled = [scale_images(batch[key], self.config.image_shape) for key in self.config.cameras]
        images = torch.cat(scaled, dim=1).contiguous(memory_format=torch.channels_last)
        state = batch[STATE] if STATE in self.config.input_features else images.new_zeros(len(images), 0)
        tasks = [task_number(self.config, task) for task in batch.get("task") or [""] * len(images)]
        return images, state, torch.tensor(tasks, device=images.device)

    def _seen_by_meta(self, images: Tensor) -> Tensor:
        return images[:, : self.config.meta_channels]
