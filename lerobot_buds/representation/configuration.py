"""Settings of the representation."""

from dataclasses import dataclass
from pathlib import Path

from lerobot_buds.core import ConfigError


@dataclass
class RepresentationConfig:
    """Settings of the representation and of its training.

    It is the multi-sensory variational auto-encoder, or, where `backbone` names one, frozen features of a pretrained
    network. "paper" is the paper, "notes" the authors' implementation notes, "code" their released code.
    """

    cameras: list[str] | None = None
    """Image features to fuse; all of the dataset where None, none of them where empty."""

    proprioception: list[str] | None = None
    """Shell-style patterns of the ``observation.state`` names to fuse; none where empty. None for all of them (ours);
    end effector and gripper fingers (code) where all names are those of our own environments."""

    proprioception_weight: float = 4.0
    """How far apart proprioception puts two frames beside what is fused or seen: the ratio of their standard deviations
    (ours, measured: docs/segmentation.md). 0 leaves what is fused as it is (paper)."""

    image_size: int = 128
    """Side of the square images the network sees (pixels), scaled down from the stored by areas (128: code)."""

    latent_dim: int = 32
    """Size of the latent (32: code); with a backbone, of each camera's part of it."""

    kl_weight: float = 0.05
    """Weight of the KL divergence against the squared errors summed over 128 x 128 pixels (0.05: code)."""

    steps: int = 20_000
    """Number of gradient steps at most (ours; the notes train 1000 epochs, or until the second plateau of the loss)."""

    batch_size: int = 128
    """Frames per step (128: notes)."""

    learning_rate: float = 1e-3
    """Peak rate of Adam (1e-3: code), falling along a half cosine to zero (ours)."""

    validation_fraction: float = 0.1
    """Part of the episodes held out to report a validation loss (ours; the original has none). It is rounded to
    whole episodes, and at least one episode is always trained on."""

    checkpoint_interval: int = 1_000
    """Steps between checkpoints and validation losses (ours)."""

    patience: int = 5
    """Validation losses in a row without a new lowest one after which training ends (ours; the code ends at the second
    plateau of the training loss). 0 goes on to `steps`. Without held-out episodes nothing is measured, and it has no
    effect."""

    mixed_precision: str = "auto"
    """``"bf16"`` for bfloat16 in the encoders and decoders while training; fusion and loss stay in float32. ``"no"``
    for float32 everywhere, ``"auto"`` for bf16 on GPUs that compute in it (ours)."""

    seed: int = 0
    """Seeds the weights, the order of the frames, the noise and the held-out episodes."""

    device: str = "auto"
    """``"auto"`` for the accelerator that is there, or ``"cpu"``."""

    backbone: str | None = None
    """A timm model's name, for example ``vit_base_patch14_dinov2.lvd142m`` (LOTUS): its frozen features take the place
    of the auto-encoder, and nothing but their projection is fitted."""

    backbone_weights: str = "pretrained"
    """``"pretrained"`` for timm's own from the Hub, the path of a ``.safetensors`` file, or ``"random"`` for seeded
    random ones, with which nothing but the mechanism can be tried."""

    backbone_image_size: int = 224
    """Side of the square images the backbone sees (pixels); smaller frames are enlarged (ours: patches of 14 and of 16
    divide it, and DINOv2's own 518 would show no more of a frame of 128 pixels)."""

    def __post_init__(self) -> None:
        """Refuses values that cannot work.

        Raises:
            ConfigError: A value is out of its range; the message quotes it.
        """
        if self.cameras == [] and self.proprioception == []:
            raise ConfigError(
                "cameras and proprioception are both empty: a representation needs at least one modality."
            )
        if self.image_size < 16:
            raise ConfigError(f"image_size={self.image_size} is under 16 pixels, the least that the encoder can take.")
        for name in ("latent_dim", "steps", "batch_size", "checkpoint_interval", "backbone_image_size"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name}={getattr(self, name)} must be at least 1.")
        if self.learning_rate <= 0 or self.kl_weight < 0:
            raise ConfigError(
                f"learning_rate={self.learning_rate} must be positive and kl_weight={self.kl_weight} not negative."
            )
        if self.proprioception_weight < 0:
            raise ConfigError(f"proprioception_weight={self.proprioception_weight} must not be negative.")
        if not 0 <= self.validation_fraction < 1:
            raise ConfigError(f"validation_fraction={self.validation_fraction} must lie in [0, 1).")
        if self.patience < 0:
            raise ConfigError(f"patience={self.patience} must not be negative; 0 never ends training early.")
        if self.device not in ("auto", "cpu"):
            raise ConfigError(f"device={self.device!r} must be 'auto' or 'cpu'.")
        if self.mixed_precision not in ("auto", "bf16", "no"):
            raise ConfigError(f"mixed_precision={self.mixed_precision!r} must be 'auto', 'bf16' or 'no'.")
        self._check_backbone()

    @property
    def side(self) -> int:
        """Side of the squares to which larger frames are scaled, once, by areas (pixels)."""
        return self.image_size if self.backbone is None else self.backbone_image_size

    def _check_backbone(self) -> None:
        if self.backbone is not None and self.cameras == []:
            raise ConfigError(f"backbone={self.backbone!r} needs a camera, but cameras is empty.")
        # Anything but safetensors can hold code that runs when it is read.
        if (
            self.backbone_weights not in ("pretrained", "random")
            and Path(self.backbone_weights).suffix != ".safetensors"
        ):
            raise ConfigError(
                f"backbone_weights={self.backbone_weights!r} must be 'pretrained', 'random' or a .safetensors file; "
                "convert other files with safetensors.torch.save_file."
            )
