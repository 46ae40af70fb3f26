"""A checkpoint of policy ``buds`` with LeRobot's processing around it, ready for one task. Imports LeRobot on use."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lerobot_buds.core import CheckpointError, read_json, sha256_of_file, sha256_of_json
from lerobot_buds.envs import Task

if TYPE_CHECKING:
    from collections.abc import Callable

    from torch import Tensor

    from lerobot_buds.envs.configuration_robosuite import RobosuiteEnvConfig
    from lerobot_buds.policy import BudsConfig
    from lerobot_buds.policy.modeling_buds import BudsPolicy

CONFIG_FILE, WEIGHTS_FILE = "config.json", "model.safetensors"


@dataclass(frozen=True)
class Checkpoint:
    """A trained policy.

    Attributes:
        policy: The policy, on its device.
        preprocess: From LeRobot's batch of observations to the policy's.
        postprocess: From the policy's actions to the environment's.
        sha256: Hash of its settings and weights.
        renamed: Name of a feature of the environment -> the policy's, as it was trained (LeRobot's ``rename_map``).
    """

    policy: "BudsPolicy"
    preprocess: "Callable[[dict[str, Any]], dict[str, Any]]"
    postprocess: "Callable[[Tensor], Tensor]"
    sha256: str
    renamed: Mapping[str, str] = field(default_factory=dict)


def load_checkpoint(name: str, env: "RobosuiteEnvConfig", task: Task, device: str | None = None) -> Checkpoint:
    """Loads a checkpoint for an environment, as ``lerobot-eval`` does.

    Args:
        name: Folder of the checkpoint (``pretrained_model``), or a repository on the Hub.
        env: The environment.
        task: Its task.
        device: Where to compute; the checkpoint's own choice where None.

    Raises:
        CheckpointError: There is no such checkpoint, it is none of policy ``buds``, or its frame rate or render profile
            are not the environment's.
        ConfigError: It was not trained on the task.
    """
    from lerobot.policies import make_policy, make_pre_post_processors

    from lerobot_buds.policy.fitting import check_environment, task_number  # registers the policy with LeRobot, too

    folder = checkpoint_folder(name)
    config = read_config(folder, device)
    check_environment(config, env.fps, env.render_profile)
    task_number(config, task.description)
    preprocess, postprocess = make_pre_post_processors(
        config,
        pretrained_path=str(folder),
        preprocessor_overrides={"device_processor": {"device": str(config.device)}},
    )
    renamed = _renamed(preprocess)
    policy = make_policy(config, env_cfg=env, rename_map=renamed)
    files = [sha256_of_file(folder / file) for file in (CONFIG_FILE, WEIGHTS_FILE)]
    return Checkpoint(policy, preprocess, postprocess, sha256_of_json(files), renamed)


def load_policy(name: str, root: Path, device: str | None = None) -> "BudsPolicy":
    """Loads a checkpoint for a dataset, without an environment.

    Args:
        name: Folder of the checkpoint, or a repository on the Hub.
        root: Folder of the dataset.
        device: Where to compute; the checkpoint's own choice where None.

    Raises:
        CheckpointError: There is no such checkpoint, it is none of policy ``buds``, or it does not fit the dataset.
        ConfigError: It does not know a task of the dataset.
        DatasetError: There is no such dataset.
        SegmentationError: The dataset is not segmented.
    """
    from lerobot.datasets import LeRobotDatasetMetadata

    from lerobot_buds.data import LocalDataset
    from lerobot_buds.policy.modeling_buds import BudsPolicy

    folder = checkpoint_folder(name)
    _ = LocalDataset(root).info  # LeRobot would ask the Hub for a dataset that is not there
    meta = LeRobotDatasetMetadata(root.name, root=root)
    return BudsPolicy.from_pretrained(folder, config=read_config(folder, device), dataset_meta=meta)


def checkpoint_folder(name: str) -> Path:
    """Finds a checkpoint of policy ``buds``, in a folder or on the Hub.

    Raises:
        CheckpointError: There is none.
    """
    from lerobot_buds.data import download

    folder = Path(name) if Path(name).is_dir() else download(name, ["*.json", "*.safetensors"])
    _check_files(folder)
    return folder


def read_config(folder: Path, device: str | None) -> "BudsConfig":
    """Reads the configuration of a checkpoint.

    Args:
        folder: The checkpoint.
        device: Where to compute; the checkpoint's own choice where None.

    Raises:
        CheckpointError: It has settings that this version does not know.
    """
    from draccus.utils import ParsingError
    from lerobot.configs import PreTrainedConfig

    from lerobot_buds.policy import BudsConfig

    try:
        config = PreTrainedConfig.from_pretrained(folder)
    except ParsingError as error:
        raise CheckpointError(
            f"{folder / CONFIG_FILE} has settings that this version does not understand ({error}): use the version of "
            "this package that wrote it, or train again."
        ) from error
    assert isinstance(config, BudsConfig)
    config.pretrained_path = folder
    config.device = device or config.device
    return config


def _renamed(preprocess: Any) -> dict[str, str]:
    from lerobot.processor import RenameObservationsProcessorStep

    steps = [step for step in preprocess.steps if isinstance(step, RenameObservationsProcessorStep)]
    return {old: new for step in steps for old, new in step.rename_map.items()}


def _check_files(folder: Path) -> None:
    missing = [file for file in (CONFIG_FILE, WEIGHTS_FILE) if not (folder / file).exists()]
    if missing:
        raise CheckpointError(
            f"{folder} is no checkpoint: it lacks {' and '.join(missing)}. lerobot-train leaves checkpoints under "
            "checkpoints/last/pretrained_model."
        )
    try:
        kind = read_json(folder / CONFIG_FILE)["type"]
    except (KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f"{folder / CONFIG_FILE} is damaged ({type(error).__name__}: {error}).") from error
    if kind != "buds":
        raise CheckpointError(f"{folder} holds a policy of type {kind!r}; only 'buds' has skills to look into.")
