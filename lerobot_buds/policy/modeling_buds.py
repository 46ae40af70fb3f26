"""Policy type ``buds``: K skills and a meta controller, trained together and rolled out at two rates."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from lerobot.policies import PreTrainedPolicy
from torch import Tensor, nn

from lerobot_buds.core import ACTION, STATE, CheckpointError, DatasetError

from .configuration_buds import BudsConfig
from .images import random_shift, scale_images
from .labels import LabelTable
from .meta_controller import MetaController
from .proprioception import Proprioception
from .rollout import Rollout
from .settling import check_render_profile, check_task, settle_on_dataset, settle_without_dataset
from .skills import SkillLibrary


class BudsPolicy(PreTrainedPolicy):  # type: ignore[misc]
    """Skills that pursue subgoals, and the meta controller that picks skill and subgoal (paper).

    The released code trains skills first and the meta controller on the finished subgoal encoders. Here one run trains
    both: the meta controller's targets are the encoders' current outputs, without gradient, so that it follows them.

    Args:
        config: The configuration; fields it leaves open are filled in place.
        dataset_stats: LeRobot's statistics of the dataset.
        dataset_meta: LeRobot's metadata of the segmented dataset to train on; without it the policy can only act.
        kwargs: Whatever else LeRobot's factory hands to constructors; not used.

    Raises:
        ConfigError: The configuration cannot work with the features.
        SegmentationError: The dataset has no valid labels.
        CheckpointError: The configuration comes from a checkpoint that does not fit the dataset.
    """

    config_class = BudsConfig
    name = "buds"

    def __init__(
        self,
        config: BudsConfig,
        dataset_stats: dict[str, dict[str, Any]] | None = None,
        dataset_meta: Any = None,
        **kwargs: Any,
    ) -> None:
        super().__init__(config)
        self.config: BudsConfig = config
        config.validate_features()
        if dataset_meta is None:
            settle_without_dataset(config)
        else:
            settle_on_dataset(config, dataset_meta)
        self.proprioception = Proprioception(config, dataset_stats)
        self.skills = SkillLibrary(config)
        self.meta_controller = MetaController(config)
        self._dataset_root = Path(dataset_meta.root) if dataset_meta is not None else None
        self._labels: LabelTable | None = None
        self._rollouts: dict[int, Rollout] = {}

    def get_optim_params(self) -> list[dict[str, Any]]:
        """Returns one named parameter group for the skills and one for the meta controller."""
        parts: dict[str, nn.Module] = {"skills": self.skills, "meta_controller": self.meta_controller}
        return [
            {"name": name, "params": [p for p in part.parameters() if p.requires_grad]} for name, part in parts.items()
        ]

    def forward(self, batch: dict[str, Any]) -> tuple[Tensor, dict[str, float]]:
        """Computes the training loss; every term is a mean over the batch, so the batch size does not weigh them.

        Args:
            batch: LeRobot's batch: the inputs, ``action`` ``(B, A)``, and ``index`` ``(B,)``, the absolute frames.

        Returns:
            The loss (scalar), and its terms and the accuracy of the skill ids, the same keys at every step.

        Raises:
            CheckpointError: An input is missing or has another shape than the policy was made for.
            ConfigError: A task is unknown.
        """
        images, state = self._inputs(batch)
        labels = self._label_table().lookup(batch["index"])
        goals = scale_images(labels.goals, self.config.image_shape)
        subgoal = self.skills.encode_subgoals(labels.skill, goals)
        if self.training and self.skills.uses_batch_statistics:
            target = self.skills.subgoal_targets(labels.skill, goals)
        else:
            target = subgoal.detach()
        if self.training:
            images = random_shift(images, self.config.crop_padding)
            subgoal = subgoal + self.config.subgoal_noise * torch.randn_like(subgoal)
        actions = self.skills(labels.skill, images, subgoal, self.proprioception(state, labels.history))
        skill_loss = (actions - batch[ACTION]).square().sum(dim=1).mean()
        meta = self.meta_controller.losses(self._workspace(images), labels.skill, target)
        loss = skill_loss + meta.skill_id + meta.subgoal + self.config.kl_weight * meta.kl
        return loss, {
            "skill_loss": skill_loss.item(),
            "skill_id_loss": meta.skill_id.item(),
            "subgoal_loss": meta.subgoal.item(),
            "kl_loss": meta.kl.item(),
            "skill_id_accuracy": meta.accuracy.item(),
        }

    def reset(self) -> None:
        """Forgets the calling thread's rollout; LeRobot may evaluate several tasks in threads that share the policy."""
        self._rollouts.pop(threading.get_ident(), None)

    @torch.no_grad()
    def select_action(
        self,
        batch: dict[str, Any],
        noise: Tensor | None = None,
        override: Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]] | None = None,
        **kwargs: Any,
    ) -> Tensor:
        """Runs one control step of all environments of a batch.

        Args:
            batch: The inputs, and ``task`` strings where there are several tasks.
            noise: ``(B, latent)`` standard normal numbers for the subgoals that are decided now; drawn from torch's
                default generator (CPU) where not given, and only in steps with a decision.
            override: Called at every decision with the ``(D,)`` int64 rows of the batch that decide now, their ``(D,)``
                int64 skills and ``(D, subgoal_dim)`` subgoals; what it returns in the place of the last two is done.
            kwargs: Not used.

        Returns:
            ``(B, A)`` actions in [-1, 1].

        Raises:
            CheckpointError: An input is missing or has another shape than the policy was made for.
            ConfigError: A task is unknown.
        """
        self.eval()
        images, state = self._inputs(batch)
        reading = self.proprioception.reading(state)
        rollout = self._rollouts.get(threading.get_ident())
        if rollout is None or len(rollout.skill) != len(images):
            rollout = Rollout.start(reading, self.config.history_frames, self.config.subgoal_dim)
            self._rollouts[threading.get_ident()] = rollout
        due = rollout.steps_left == 0
        if due.any():
            if noise is None:
                noise = torch.randn(len(images), self.config.meta_latent)
            skill, subgoal = self.meta_controller(self._workspace(images)[due], noise.to(images)[due])
            if override is not None:
                skill, subgoal = override(due.nonzero()[:, 0], skill, subgoal)
            rollout.decide(due, skill, subgoal, self.config.meta_period)
        proprio = self.proprioception(state, rollout.history)
        actions: Tensor = self.skills(rollout.skill, images, rollout.subgoal, proprio)
        rollout.advance(reading)
        return actions

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
        return {**self.__dict__, "_labels": None, "_rollouts": {}}

    def _label_table(self) -> LabelTable:
        if self._labels is None:
            if self._dataset_root is None:
                raise DatasetError("This policy was built without a dataset: it can act, but not compute a loss.")
            camera = self.config.cameras[0]
            self._labels = LabelTable(
                self._dataset_root,
                camera,
                tuple(self.config.image_features[camera].shape),
                self.config.history_dims or [],
                self.config.history_frames,
            )
        return self._labels

    def _inputs(self, batch: dict[str, Any]) -> tuple[Tensor, Tensor]:
        """Checks a batch; returns stacked images ``(B, C, H, W)`` of network size, and the state ``(B, D)``."""
        missing = [key for key in self.config.input_features if key not in batch]
        if missing:
            known = sorted(key for key in batch if key.startswith("observation"))
            raise CheckpointError(f"The policy needs {missing}, which the observation lacks. It has {known}.")
        for key, feature in self.config.input_features.items():
            expected, given = tuple(feature.shape), tuple(batch[key].shape[1:])
            if expected != given:
                raise CheckpointError(f"{key}: the policy was made for shape {expected}, the observation has {given}.")
        check_render_profile(self.config, batch.get("observation.render_profile"))
        for task in set(batch.get("task") or [""]):
            check_task(self.config, task)
        scaled = [scale_images(batch[key], self.config.image_shape) for key in self.config.cameras]
        images = torch.cat(scaled, dim=1)
        return images, batch[STATE] if STATE in self.config.input_features else images.new_zeros(len(images), 0)

    def _workspace(self, images: Tensor) -> Tensor:
        return images[:, : self.config.image_features[self.config.cameras[0]].shape[0]]
