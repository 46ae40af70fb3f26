"""Settings of the representation."""

from dataclasses import dataclass, field

from lerobot_buds.core import ConfigError


@dataclass
class RepresentationConfig:
    """Settings of the multi-sensory variational auto-encoder and of its training.

    "paper" is the paper, "notes" the authors' implementation notes, "code" their released code.
    """

    cameras: list[str] | None = None
    """Image features to fuse; all cameras of the dataset where None, none of them where empty."""

    proprioception: list[str] = field(default_factory=lambda: ["eef*", "gripper*"])
    """Shell-style patterns of the ``observation.state`` names to fuse; none where empty. Where no name matches, all
    dimensions are used. Default: end effector position and gripper fingers (code)."""

    image_size: int = 128
    """Side of the square images the network sees (pixels), box-downscaled from the stored (128: code)."""

    latent_dim: int = 32
    """Size of the latent (32: code)."""

    kl_weight: float = 0.05
    """Weight of the KL divergence against the squared errors summed over 128 x 128 pixels (0.05: code)."""

    steps: int = 20_000
    """Number of gradient steps (ours; the notes train 1000 epochs, or until the second plateau of the loss)."""

    batch_size: int = 128
    """Frames per step (128: notes)."""

    learning_rate: float = 1e-3
    """Peak rate of Adam (1e-3: code), falling along a half cosine to zero (ours)."""

    validation_fraction: float = 0.1
    """Part of the episodes held out to report a validation loss (ours; the original has none). It is rounded to
    whole episodes, and at least one episode is always trained on."""

    checkpoint_interval: int = 1_000
    """Steps between checkpoints and validation losses (ours)."""

    seed: int = 0
    """Seeds the weights, the order of the frames, the noise and the held-out episodes."""

    device: str = "auto"
    """``"auto"`` for the accelerator that is there, or ``"cpu"``."""

    def __post_init__(self) -> None:
        """Refuses values that cannot work.

        Raises:
            ConfigError: A value is out of its range; the message quotes it.
        """
        if self.cameras == [] and not self.proprioception:
            raise ConfigError(
                "cameras and proprioception are both empty: a representation needs at least one modality."
            )
        if self.image_size < 16:
            raise ConfigError(f"image_size={self.image_size} is under 16 pixels, the least that the encoder can take.")
        for name in ("latent_dim", "steps", "batch_size", "checkpoint_interval"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name}={getattr(self, name)} must be at least 1.")
        if self.learning_rate <= 0 or self.kl_weight < 0:
            raise ConfigError(
                f"learning_rate={self.learning_rate} must be positive and kl_weight={self.kl_weight} not negative."
            )
        if not 0 <= self.validation_fraction < 1:
            raise ConfigError(f"validation_fraction={self.validation_fraction} must lie in [0, 1).")
        if self.device not in ("auto", "cpu"):
            raise ConfigError(f"device={self.device!r} must be 'auto' or 'cpu'.")
