"""Policy type ``buds``: the model as LeRobot trains and runs it."""

import threading
from pathlib import Path
from typing import Any, Self

import torch
from lerobot.policies import PreTrainedPolicy
from safetensors import SafetensorError
from torch import Tensor

from lerobot_buds.core import CheckpointError

from .card import card_text, write_card
from .configuration_buds import BudsConfig
from .fitting import check_observation, check_tasks, complete
from .graphs import GraphedSteps
from .inputs import Observation, read_actions, read_inputs
from .labels import Labels, LabelTable
from .library import TrainedSkills
from .model import BudsModel
from .networks import compile_encoders, lay_out
from .processor_buds import offer_labels
from .rollout import Override, Rollout


class BudsPolicy(PreTrainedPolicy):  # type: ignore[misc]
    """`BudsModel` as LeRobot trains and runs it.

    Args:
        config: The configuration; fields it leaves open are filled in place.
        dataset_stats: LeRobot's statistics of the dataset.
        dataset_meta: LeRobot's metadata of the dataset to train on; without it the policy can only act.
        from_checkpoint: Weights will be loaded, so that those of a skill library are not wanted; the same where the
            configuration names a checkpoint.
        kwargs: Whatever else LeRobot's factory hands to constructors; not used.

    Attributes:
        labels: What the dataset says about its frames; None without one, and in copies.

    Raises:
        ConfigError: The configuration cannot work with the features.
        SegmentationError: The dataset has no valid labels.
        CheckpointError: The checkpoint or the skill library does not fit the dataset.
    """

    config_class = BudsConfig
    name = "buds"

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
        # LeRobots after 0.6.1 construct a policy without `from_pretrained` where its weights stream in afterwards.
        from_checkpoint = from_checkpoint or config.pretrained_path is not None
        library = TrainedSkills.read(config.skills_path) if config.skills_path and not from_checkpoint else None
        self._found = complete(config, dataset_meta, library, from_checkpoint)
        self.labels = LabelTable(Path(dataset_meta.root), config) if dataset_meta is not None else None
        if self.labels is not None:
            offer_labels(self.labels)
        self.model = BudsModel(config, *(None,) * 3 if from_checkpoint else (self._found, dataset_stats, self.labels))
        if library is not None:
            library.load_into(self.model)
            self._warn_of_unreachable_actions()
        self.model.skills.requires_grad_(config.skills_path is None)
        if config.compile_model:
            compile_encoders(self.model)
        self._graphed_steps: GraphedSteps | None = None
        self._rollouts: dict[int, Rollout] = {}
        self._laid_out_for_acting = False

    @classmethod
    def from_pretrained(
        cls, pretrained_name_or_path: str | Path, *, config: BudsConfig | None = None, **kwargs: Any
    ) -> Self:
        """Reads a checkpoint, see LeRobot's method of the same name; frozen skills are part of it.

        Raises:
            ConfigError: The configuration has tasks for which the weights are not.
            CheckpointError: The file of weights is none.
        """
        if config is not None:
            check_tasks(config, BudsConfig.from_pretrained(pretrained_name_or_path, **kwargs))
        try:
            read = super().from_pretrained
            policy: Self = read(pretrained_name_or_path, config=config, from_checkpoint=True, **kwargs)
        except SafetensorError as error:
            raise CheckpointError(
                f"{pretrained_name_or_path} holds no readable weights ({error}): fetch the checkpoint again."
            ) from error
        policy._warn_of_unreachable_actions()
        if policy.labels is not None and policy.model.meta_controllers is not None:
            policy.model.memory.widen(*map(torch.from_numpy, (policy.labels.shortest, policy.labels.longest)))
        return policy

    def _save_pretrained(self, save_directory: Path, *args: Any, **kwargs: Any) -> None:
        """Writes configuration and weights as LeRobot does, and a card beside them, for whoever uploads the folder."""
        super()._save_pretrained(save_directory, *args, **kwargs)
        write_card(save_directory, card_text(self.config), self.config.license, self.config.tags or ())

    def generate_model_card(self, *args: Any, **kwargs: Any) -> Any:
        """Puts what this policy is before LeRobot's card; LeRobot's pushes call this method of theirs."""
        card = super().generate_model_card(*args, **kwargs)
        card.text = f"\n{card_text(self.config)}\n{card.text.lstrip()}"
        return card

    def _warn_of_unreachable_actions(self) -> None:
        if self._found is not None:
            self.model.actions.warn_of_unreachable(self._found)

    def get_optim_params(self) -> list[dict[str, Any]]:
        """Returns one named parameter group for what is trained of skills and meta controllers each.

        Adam is the fused one: a third of the time on a CPU, and fewer kernels on a GPU. LeRobot lets it be said here
        alone, and resumes only checkpoints that say the same.
        """
        parts = {"skills": self.model.skills, "meta_controllers": self.model.meta_controllers}
        trained = {
            name: [p for p in part.parameters() if p.requires_grad] for name, part in parts.items() if part is not None
        }
        return [{"name": name, "params": params, "fused": True} for name, params in trained.items() if params]

    def train(self, mode: bool = True) -> Self:
        """Switches to training, in which frozen skills keep their batch statistics."""
        super().train(mode)
        if mode:
            self._lay_out_for_acting(False)
        if mode and self.config.skills_path is not None:
            self.model.skills.eval()
        return self

    def forward(self, batch: dict[str, Any], reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """Computes the training loss; every term is a mean over the batch, so the batch size does not weigh them.

        Args:
            batch: LeRobot's batch with `Labels`: the inputs, and ``action`` ``(B, A)`` or ``(B, n, A)``.
            reduction: ``"mean"``, or ``"none"`` for the loss of every sample, as LeRobot's weighting asks for.

        Returns:
            The loss (scalar, or ``(B,)``), and the means of all terms of `BudsModel.forward`, the same at every step.

        Raises:
            CheckpointError: An input is missing or has another shape than the policy was made for.
            ConfigError: A task is unknown.
            DatasetError: The labels are missing.
        """
        observation, labels = read_inputs(self.config, batch), Labels.of(batch)
        actions = read_actions(self.config, batch)
        sample = self.model.sample(observation, labels, actions, batch.get("action_is_pad"))
        terms = self._steps(sample) if self._replays and torch.is_grad_enabled() else self.model.terms(sample)
        loss = self.model.loss(terms, labels)
        means = torch.stack([term.detach().float().mean() for term in terms.values()]).tolist()
        return loss if reduction == "none" else loss.mean(), dict(zip(terms, means, strict=True))

    @property
    def _replays(self) -> bool:
        """Whether training steps are replayed; a setting for GPUs that CPUs pass over, so that checkpoints move."""
        return self.config.cuda_graphs and self.training and next(self.parameters()).is_cuda

    @property
    def _steps(self) -> GraphedSteps:
        if self._graphed_steps is None:
            self._graphed_steps = GraphedSteps(self.model)
        return self._graphed_steps

    def reset(self) -> None:
        """Forgets the calling thread's rollout; LeRobot may evaluate several tasks in threads that share the policy."""
        self._rollouts.pop(threading.get_ident(), None)

    def drop_queued_actions(self) -> None:
        """Has the calling thread's rollout decide and plan anew at its next step, for a new task say; the rest stays.

        LeRobots after 0.6.1 call it; theirs finds queues of actions by name, and there is none here.
        """
        if (rollout := self._rollouts.get(threading.get_ident())) is not None:
            rollout.drop_plans()

    @torch.no_grad()
    def select_action(
        self, batch: dict[str, Any], noise: Tensor | None = None, override: Override | None = None, **kwargs: Any
    ) -> Tensor:
        """Runs one control step of all environments of a batch, on a CPU one by one.

        Args:
            batch: The inputs, and ``task`` strings where there are several tasks.
            noise: ``(B, latent)`` standard normal numbers for the subgoals that are decided now, with
                `drawn_subgoals`; drawn from torch's default generator (CPU) where not given.
            override: Called at every decision, see `Rollout.step`.
            kwargs: Not used.

        Returns:
            ``(B, A)`` float32 actions, in the unit of the demonstrations.

        Raises:
            CheckpointError: An input is missing or has another shape than the policy was made for; or, at the first
                step, the environment is not that of the demonstrations.
            ConfigError: A task is unknown.
        """
        observation = self._observe(batch)
        rollout = self._rollouts.get(threading.get_ident())
        if rollout is None or len(rollout.skill) != len(observation.images):
            check_observation(self.config, batch)
            rollout = Rollout.start(self.model, observation)
            self._rollouts[threading.get_ident()] = rollout
        # On a CPU batches gain little, and without them no episode depends on those that run beside it.
        return rollout.step(self.model, observation, noise, override, together=rollout.skill.device.type != "cpu")

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Any], noise: Tensor | None = None, **kwargs: Any) -> Tensor:
        """Predicts what would be done from here on if a decision fell due now; a rollout stays as it is.

        Outside of a rollout the meta controller goes by what it sees and feels alone, and the gripper is taken to have
        been as it is.

        Returns:
            ``(B, chunk_size, A)`` float32 actions, in the unit of the demonstrations. For arguments and errors see
            `select_action`.
        """
        observation = self._observe(batch)
        rollout = self._rollouts.get(threading.get_ident())
        if rollout is None or len(rollout.skill) != len(observation.images):
            check_observation(self.config, batch)
            return Rollout.start(self.model, observation).foresee(self.model, observation, noise, remembers=False)
        return rollout.foresee(self.model, observation, noise)

    def _observe(self, batch: dict[str, Any]) -> Observation:
        if self.training:
            self.eval()
        self._lay_out_for_acting(True)
        return read_inputs(self.config, batch)

    def _lay_out_for_acting(self, acting: bool) -> None:
        # Not before the first action: optimisers and data parallelism take the order in which they find the weights.
        # Nor where graphs are replayed: they know where the weights lie.
        if acting != self._laid_out_for_acting and not self.config.cuda_graphs:
            lay_out(self, torch.channels_last if acting else torch.contiguous_format)
            self._laid_out_for_acting = acting

    @property
    def current_skills(self) -> Tensor | None:
        """Skill in force in every environment of the calling thread's rollout, ``(B,)`` int64; None after a reset."""
        rollout = self._rollouts.get(threading.get_ident())
        return None if rollout is None else rollout.skill

    def __getstate__(self) -> dict[str, Any]:
        """Leaves labels, rollouts and graphs out of copies: they belong to one process."""
        return {**self.__dict__, "labels": None, "_rollouts": {}, "_graphed_steps": None}
