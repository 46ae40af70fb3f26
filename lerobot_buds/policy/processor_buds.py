"""The pre- and post-processing of policy type ``buds``, found by LeRobot by its name."""

from typing import Any

from lerobot.processor import PolicyAction, PolicyProcessorPipeline, make_default_pre_post_processors
from torch import Tensor

from .configuration_buds import BudsConfig


def make_buds_pre_post_processors(
    config: BudsConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]],
    PolicyProcessorPipeline[PolicyAction, PolicyAction],
]:
    """Returns LeRobot's default pipelines; with the configuration's identity mapping they scale nothing.

    Args:
        config: The policy's configuration.
        dataset_stats: Statistics of the dataset, passed on.
    """
    pipelines: tuple[Any, Any] = make_default_pre_post_processors(
        config, dataset_stats, normalizer_device=config.device
    )
    return pipelines
