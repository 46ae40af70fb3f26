"""The pre- and post-processing of policy type ``buds``, found by LeRobot by its name: here labels join the batch."""

from typing import Any

from lerobot.configs import PipelineFeatureType, PolicyFeature
from lerobot.lerobot_types import EnvTransition, TransitionKey
from lerobot.processor import (
    PolicyAction,
    PolicyProcessorPipeline,
    ProcessorStep,
    make_default_policy_processor_steps,
    make_policy_processor_pipelines,
)
from torch import Tensor

from .configuration_buds import BudsConfig
from .labels import LabelTable

INDEX = "index"

_offered: list[LabelTable] = []


def offer_labels(labels: LabelTable) -> None:
    """Makes the labels of a dataset known to the `LabelsStep` of this process.

    LeRobot tells the policy that it builds which dataset there is; its processors it tells in a fresh run only, and
    reads them from files in one that goes on, or starts from a checkpoint.

    Args:
        labels: They take the place of those offered before.
    """
    _offered[:] = [labels]


class LabelsStep(ProcessorStep):  # type: ignore[misc]
    """Joins `Labels` to batches of the dataset that a policy was last built for; others, as rollouts', pass unchanged.

    It is not in LeRobot's registry, so that checkpoints find it by its module, whatever has been imported before.
    """

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Adds what `LabelTable.lookup` finds to the complementary data."""
        data = transition.get(TransitionKey.COMPLEMENTARY_DATA) or {}
        index, actions = data.get(INDEX), transition.get(TransitionKey.ACTION)
        if index is None or not _offered or not _offered[0].holds(index, actions):
            return transition
        observation = transition.get(TransitionKey.OBSERVATION) or {}
        labels = _offered[0].lookup(index, observation)
        joined: EnvTransition = {**transition, TransitionKey.COMPLEMENTARY_DATA: {**data, **labels.in_batch()}}
        return joined

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Changes none: labels are no inputs."""
        return features


def make_buds_pre_post_processors(
    config: BudsConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]],
    PolicyProcessorPipeline[PolicyAction, PolicyAction],
]:
    """Returns LeRobot's default pipelines with labels joined; with the identity mapping they scale nothing.

    Args:
        config: The policy's configuration.
        dataset_stats: Statistics of the dataset, passed on.
    """
    steps = make_default_policy_processor_steps(config, dataset_stats, normalizer_device=config.device)
    pipelines: tuple[Any, Any] = make_policy_processor_pipelines(
        input_steps=[steps.rename_observations, steps.add_batch_dim, LabelsStep(), steps.to_device, steps.normalize],
        output_steps=[steps.unnormalize, steps.to_cpu],
    )
    return pipelines
