"""The configuration of policy type ``buds``; importing it registers the type with LeRobot."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from lerobot.configs import NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.optim import AdamConfig
from lerobot.optim.schedulers import CosineAnnealingWithWarmupSchedulerConfig  # not exported by lerobot.optim

from lerobot_buds.core import STATE, WORKSPACE_CAMERA, ConfigError, frames_of_seconds, near_names

from .pauses import PAUSE_S

logger = logging.getLogger(__name__)

PAPER_FPS = 20
PAPER_PIXELS = 128
RESNET_MIN_PIXELS = 64
RGB = 3
"""Channels of the images that are used."""

CHOICES = {
    "skills": ("segments", "single", "flat"),
    "encoder": ("resnet18", "conv"),
    "norm": ("batch", "group"),
    "subgoal_space": ("image", "latent"),
    "heads": ("separate", "residual"),
    "meta_controllers": ("per_task", "conditioned"),
    "meta_trunk": ("own", "skills"),
    "meta_cameras": ("workspace", "all"),
}
"""Fields of the configuration that take one word, and the words."""

ACTION_SCALINGS = ("bounds", "none")
"""Words of `action_scaling`, which may also be left open."""

LIBRARY_FIELDS = (
    *("skills", "subgoal_horizon_s", "cameras", "workspace_camera", "image_size", "current_state", "history_state"),
    *("gripper_history_s", "encoder", "norm", "conv_channels", "keypoints", "image_feature", "subgoal_space"),
    *(
        "subgoal_dim",
        "head_widths",
        "heads",
        "shared_trunk",
        "chunk_size",
        "n_action_steps",
        "n_skills",
        "segmentation",
    ),
    *("fps", "representation", "render_profile", "state_names", "current_dims", "history_dims", "action_scaling"),
    *("binary_dims",),
)
"""Fields that say what the skills are: with `skills_path` they are those of the library."""


@PreTrainedConfig.register_subclass("buds")
@dataclass
class BudsConfig(PreTrainedConfig):  # type: ignore[misc]
    """Settings of the K skills and the meta controller; the defaults are the paper's sizes.

    Fields left at None or empty are filled from the dataset when the policy is built, and saved with the checkpoint.
    Durations are in seconds; `fps` converts them to frames.

    Raises:
        ConfigError: A value cannot work.
    """

    # Which skills
    skills: str = "segments"  # as labelled (paper); "single": one for whole demonstrations (paper: GTI); "flat": one
    # without subgoals and meta controller (paper: flat behaviour cloning). The last two need no segmentation
    subgoal_horizon_s: float = 1.5  # of "single" (notes); with "segments" the dataset says
    skills_path: str | None = None  # trained policy, folder or Hub, whose skills are taken over and frozen

    # Inputs. Everything goes in and out unchanged; the policy scales state and actions with buffers of its own, so that
    # a skill keeps its scaling when it is trained further on another dataset.
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {
            "VISUAL": NormalizationMode.IDENTITY,
            "STATE": NormalizationMode.IDENTITY,
            "ACTION": NormalizationMode.IDENTITY,
        }
    )
    cameras: list[str] | None = None  # names of those to use, without depth maps; None: all
    workspace_camera: str | None = None  # None: the agent view where there is one, else the first camera
    image_size: int | None = None  # side of the squares that images are scaled down to by areas; None: 128 (paper), or
    # as stored where that is smaller
    crop_padding: int = 4  # pixels after scaling; random shift of the images in training (paper: DrQ; notes: 4)
    current_state: list[str] | None = None  # patterns of names: read now. None: all; of our environments, the joints
    history_state: list[str] | None = None  # read before now. None: nothing; of our environments, the gripper
    gripper_history_s: float = 0.25  # how far back; 5 readings at 20 Hz (released code)

    # Actions; what None stands for the dataset decides, see `policy.actions`
    action_scaling: str | None = None  # "bounds": least and greatest of the dataset; "none": they lie in [-1, 1]
    binary_dims: list[int] | None = None  # dimensions that take one of two values; None: those that do in the dataset

    # Networks
    encoder: str = "resnet18"  # "resnet18" (paper) or "conv": a small one for CPUs, of the same structure (ours)
    norm: str = "batch"  # "batch" (released code) or "group" (ours: no statistics of small per-skill batches)
    conv_channels: list[int] = field(default_factory=lambda: [32, 64, 64])  # stages of "conv" (ours)
    keypoints: int = 64  # maps of the spatial softmax (notes)
    image_feature: int = 64  # released code
    subgoal_space: str = "image"  # each skill encodes the goal's image (paper), or "latent": the goal frame's latent
    # in the representation that the skills were found with, the same for all skills and at all steps (ours)
    subgoal_dim: int = 32  # notes; with "latent" the representation says
    subgoal_noise: float = 0.1  # standard deviation, training only (notes)
    imagined_subgoals: float = 0.0  # share of training frames whose skills get imagined subgoals (ours)
    head_widths: list[int] = field(default_factory=lambda: [300, 400])  # notes; multi-task: 300, 300, 400
    heads: str = "separate"  # (paper) or "residual": what a skill adds to a flat head, at first nothing (ours)
    shared_trunk: bool = False  # one convolutional trunk for all skills (ours; paper: nothing shared)
    chunk_size: int = 1  # actions a skill predicts at once (paper: 1)
    n_action_steps: int = 1  # of them are carried out before it looks again, or fewer where a decision falls due
    compile_model: bool = False  # torch.compile for the encoders
    cuda_graphs: bool = False  # training steps on a GPU as CUDA graphs; needs norm="group" (ours)

    # Meta controller
    meta_controllers: str = "per_task"  # one for each task (paper), or one that is "conditioned" on the task (ours)
    meta_trunk: str = "own"  # (paper), or "skills": on top of their shared trunk (ours)
    meta_cameras: str = "workspace"  # (paper) or "all"; with the skills' trunk all
    meta_proprioception: bool = True  # sees what the skills feel (ours; paper: images alone)
    skill_memory: bool = True  # knows the skill in force, since when, and those run before (ours; paper: not)
    memory_dropout: float = 0.3  # share of training frames at which it does not, lest it copies the past (ours)
    decoder_sees_skill: bool = True  # the subgoal is imagined for the skill that was picked (ours; released: not)
    drawn_subgoals: bool = False  # latent drawn afresh at every decision (released code); else its mean, 0 (ours)
    meta_period_s: float = 0.25  # 4 Hz (paper)
    meta_latent: int = 64  # released code
    meta_encoder_widths: list[int] = field(default_factory=lambda: [256, 256])  # released code
    meta_head_widths: list[int] = field(default_factory=lambda: [300, 400])  # released code
    meta_conv_feature: int = 128  # image feature with encoder "conv"; ResNet-18 gives 512 (ours)
    kl_weight: float = 0.02  # per sample: 2 subgoal_noise^2, see docs/policy.md (ours; released: 1e-4)

    # Training
    boundary_overlap_s: float = 0.5  # how far skills also learn the frames beside their segments (ours; paper: 0)
    balance_skills: bool = False  # every skill weighs the same, however many frames it has (ours)
    pause_weight: float = 1.0  # of frames from which nothing moves for a moment, see `policy.pauses` (ours; paper: 1)
    optimizer_lr: float = 1e-4  # Adam (notes)
    optimizer_grad_clip_norm: float = 10.0  # LeRobot's default
    push_to_hub: bool = False

    # Filled from the dataset
    n_skills: int | None = None
    segmentation: str | None = None  # hash of the labels: under another segmentation skill ids mean something else
    representation: str | None = None  # hash of the one that latent subgoals are of
    parents: dict[str, dict[str, str]] = field(default_factory=dict)  # "dataset" and "skills": repository, commit, hash
    fps: float | None = None
    render_profile: str | None = None  # how a simulator drew the demonstrations; None where that is not recorded
    tasks: list[str] = field(default_factory=list)
    state_names: list[str] = field(default_factory=list)
    current_dims: list[int] | None = None
    history_dims: list[int] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, known in CHOICES.items():
            if (value := getattr(self, name)) not in known:
                raise ConfigError(f"{name}={value!r} is unknown. {near_names(str(value), known)}")
        if self.action_scaling not in (None, *ACTION_SCALINGS):
            raise ConfigError(
                f"action_scaling={self.action_scaling!r} is unknown. "
                f"{near_names(str(self.action_scaling), ACTION_SCALINGS)}"
            )
        counts = ("image_size", "n_skills", "keypoints", "image_feature", "subgoal_dim", "meta_latent")
        for name in (*counts, "chunk_size", "n_action_steps"):
            if (value := getattr(self, name)) is not None and value < 1:
                raise ConfigError(f"{name}={value} must be at least 1.")
        for name in ("crop_padding", "subgoal_noise", "kl_weight", "boundary_overlap_s"):
            if (value := getattr(self, name)) < 0:
                raise ConfigError(f"{name}={value} must not be negative.")
        for name in ("gripper_history_s", "subgoal_horizon_s", "meta_period_s", "optimizer_lr", "fps"):
            if (value := getattr(self, name)) is not None and not value > 0:
                raise ConfigError(f"{name}={value} must be positive.")
        if not self.conv_channels:
            raise ConfigError("conv_channels is empty: the encoder needs at least one stage.")
        for name in ("imagined_subgoals", "memory_dropout", "pause_weight"):
            if not 0 <= (value := getattr(self, name)) <= 1:
                raise ConfigError(f"{name}={value} is a share: between 0 and 1.")
        if self.memory_dropout == 1:
            raise ConfigError("memory_dropout=1 would never train the memory; skill_memory=false does without.")
        if self.n_action_steps > self.chunk_size:
            raise ConfigError(f"n_action_steps={self.n_action_steps} is more than chunk_size={self.chunk_size} has.")
        if self.subgoal_space == "latent" and self.skills == "single":
            raise ConfigError("subgoal_space='latent' takes a segmented dataset's representation; 'single' has none.")
        if self.meta_trunk == "skills" and not self.shared_trunk:
            raise ConfigError("meta_trunk='skills' needs shared_trunk: without it every skill has one of its own.")
        if self.cuda_graphs and self.norm != "group":
            raise ConfigError("cuda_graphs needs norm='group': it fills up batches, which batch statistics would see.")
        if self.cuda_graphs and self.compile_model:
            raise ConfigError("cuda_graphs and compile_model exclude each other.")
        if self.skills == "flat" and self.skills_path is not None:
            raise ConfigError("skills='flat' has no meta controller to train on the skills of skills_path.")

    @property
    def stacked_cameras(self) -> list[str]:
        """The image keys in the order in which they are stacked, the workspace camera first."""
        first = self.workspace_camera or next(iter(self.image_features))
        return [first, *(key for key in self.image_features if key != first)]

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width (pixels) of the images inside the networks."""
        if self.image_size is not None:
            return self.image_size, self.image_size
        _, height, width = self.image_features[self.stacked_cameras[0]].shape
        return height, width

    @property
    def state_size(self) -> int:
        """Dimensions of ``observation.state``, 0 without one."""
        return int(self.robot_state_feature.shape[0]) if self.robot_state_feature else 0

    @property
    def history_frames(self) -> int:
        """Frames of the history of the state (gripper history in the paper)."""
        return frames_of_seconds(self.gripper_history_s, self.fps or PAPER_FPS)

    @property
    def meta_period(self) -> int:
        """Frames for which a decision of the meta controller is held."""
        return frames_of_seconds(self.meta_period_s, self.fps or PAPER_FPS)

    @property
    def pause(self) -> int:
        """Frames for which nothing moves in a pause."""
        return frames_of_seconds(PAUSE_S, self.fps or PAPER_FPS)

    @property
    def boundary_overlap(self) -> int:
        """Frames beside a segment that its skill learns as well."""
        return frames_of_seconds(self.boundary_overlap_s, self.fps or PAPER_FPS) if self.boundary_overlap_s else 0

    @property
    def subgoal_horizon(self) -> int:
        """Frames to the subgoal, with "single" skills."""
        return frames_of_seconds(self.subgoal_horizon_s, self.fps or PAPER_FPS)

    @property
    def has_subgoals(self) -> bool:
        """Whether there are subgoals, hence a meta controller that picks them."""
        return self.skills != "flat"

    @property
    def task_count(self) -> int:
        """Tasks that networks are told apart by; 0 where there is nothing to tell."""
        return len(self.tasks) if len(self.tasks) > 1 else 0

    @property
    def meta_channels(self) -> int:
        """Channels of the images that the meta controller sees; the workspace camera's come first."""
        shown = self.stacked_cameras if self.meta_cameras == "all" else self.stacked_cameras[:1]
        return sum(int(self.image_features[camera].shape[0]) for camera in shown)

    @property
    def felt_dims(self) -> list[int]:
        """Dimensions of the state that are read at all, now or before now."""
        return sorted({*(self.current_dims or []), *(self.history_dims or [])})

    @property
    def proprio_size(self) -> int:
        """Dimensions of a skill's proprioception: the current state and the gripper history."""
        return len(self.current_dims or []) + len(self.history_dims or []) * self.history_frames

    def limit_image_size(self) -> None:
        """Scales larger images down to the paper's size where nothing is said: trained as stored they cost 19 times."""
        smallest = min((min(f.shape[1:]) for f in self.image_features.values() if len(f.shape) == 3), default=0)
        if self.image_size is None and smallest > PAPER_PIXELS:
            self.image_size = PAPER_PIXELS
            logger.info("Images of %d pixels and more are scaled to %d (image_size).", smallest, PAPER_PIXELS)

    def validate_features(self) -> None:
        """Checks that inputs and outputs fit the networks, leaves out what is not used, and names the cameras.

        Raises:
            ConfigError: No camera, cameras that cannot be stacked, a state or an action that is no vector.
        """
        features: dict[str, PolicyFeature] = self.input_features
        if self.action_feature is None or len(self.action_feature.shape) != 1:
            raise ConfigError("Policy 'buds' needs one action vector named 'action'.")
        if STATE in features and len(features[STATE].shape) != 1:
            raise ConfigError(f"{STATE} has shape {tuple(features[STATE].shape)}; policy 'buds' reads a vector.")
        images = self._chosen_cameras()
        if self.workspace_camera is None:
            self.workspace_camera = WORKSPACE_CAMERA if WORKSPACE_CAMERA in images else next(iter(images))
        if self.workspace_camera not in images:
            known = near_names(self.workspace_camera, images)
            raise ConfigError(f"workspace_camera={self.workspace_camera!r} is not a camera of the data. {known}")
        # What is not used would be demanded from environments in vain.
        unused = [key for key in features if key not in {*images, STATE}]
        for key in unused:
            del features[key]
        logger.info("The policy sees %s, first the workspace, and does not use %s.", self.stacked_cameras, unused)
        self._validate_image_shapes({key: tuple(feature.shape) for key, feature in images.items()})

    def _chosen_cameras(self) -> dict[str, PolicyFeature]:
        images: dict[str, PolicyFeature] = self.image_features
        for camera in self.cameras or []:
            if camera not in images:
                raise ConfigError(f"cameras: {camera!r} is not a camera of the data. {near_names(camera, images)}")
        if self.cameras is not None:
            images = {key: feature for key, feature in images.items() if key in self.cameras}
        if not images:
            raise ConfigError(f"Policy 'buds' needs at least one camera; it was given {list(self.image_features)}.")
        refuse_other_images(images, [key for key, feature in images.items() if feature.shape[0] != RGB])
        return images

    def _validate_image_shapes(self, shapes: dict[str, tuple[int, ...]]) -> None:
        smallest = min(min(shape[1:]) for shape in shapes.values())
        if self.image_size is None and len(set(shapes.values())) > 1:
            raise ConfigError(
                f"The cameras have different shapes and cannot be stacked: {shapes}. Set image_size to scale them all, "
                "or name those to use by cameras."
            )
        if self.image_size is not None and self.image_size > smallest:
            raise ConfigError(f"image_size={self.image_size} would enlarge images: {shapes}.")
        if self.encoder == "resnet18" and min(self.image_shape) < RESNET_MIN_PIXELS:
            raise ConfigError(
                f"encoder='resnet18' needs images of at least {RESNET_MIN_PIXELS} pixels, these have "
                f"{min(self.image_shape)}. Use encoder='conv'."
            )

    def get_optimizer_preset(self) -> AdamConfig:
        """Adam without weight decay (paper's notes)."""
        return AdamConfig(lr=self.optimizer_lr, weight_decay=0.0, grad_clip_norm=self.optimizer_grad_clip_norm)

    def get_scheduler_preset(self) -> CosineAnnealingWithWarmupSchedulerConfig:
        """Cosine decay to zero over the run (ours; the paper keeps the rate and stops after 2001 epochs)."""
        return CosineAnnealingWithWarmupSchedulerConfig(num_warmup_steps=0)

    @property
    def observation_delta_indices(self) -> None:
        """None: LeRobot hands over single frames; the gripper history is looked up by the policy."""
        return None

    @property
    def action_delta_indices(self) -> list[int] | None:
        """The frames of a chunk of actions, relative to the present one; None for a single action."""
        return list(range(self.chunk_size)) if self.chunk_size > 1 else None

    @property
    def reward_delta_indices(self) -> None:
        """None: rewards are not used."""
        return None


def refuse_other_images(images: Mapping[str, PolicyFeature], others: Sequence[str]) -> None:
    """Refuses depth maps, grey and RGBA images, which mean nothing among the colours of others.

    Args:
        images: The cameras that would be used.
        others: Those of them that are no RGB cameras.

    Raises:
        ConfigError: There are any; names the setting that leaves them out.
    """
    if others:
        shapes = {key: tuple(images[key].shape) for key in others}
        kept = [key for key in images if key not in others]
        remedy = f"Leave them out: --policy.cameras='[{', '.join(kept)}]'." if kept else "The data has no RGB camera."
        raise ConfigError(f"Policy 'buds' sees RGB images of shape (3, H, W), but these are none: {shapes}. {remedy}")
