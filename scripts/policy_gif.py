"""Draws README's moving picture: an episode, seen larger than the policy sees it, over the ribbon of its skills.

    python scripts/policy_gif.py --policy_path=outputs/policy --task=kitchen/full --image_size=64 \
        --render_profile=fastest --output=docs/kitchen.gif

A second environment takes the same actions from the same seed, which makes the same episode.
"""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lerobot_buds.cli.running import parse, run
from lerobot_buds.core import BudsError, write_atomically
from lerobot_buds.envs import FPS, EnvSettings, RobosuiteEnv, tasks_named
from lerobot_buds.envs.configuration_robosuite import RobosuiteEnvConfig
from lerobot_buds.evaluation.checkpoint import load_checkpoint
from lerobot_buds.evaluation.episodes import Decider, EpisodeRecorder, run_episodes
from lerobot_buds.evaluation.video import episode_frames


@dataclass
class GifConfig:
    """Settings of one picture."""

    policy_path: str
    """Checkpoint."""

    task: str
    """Task that it is for."""

    output: Path
    """The picture."""

    image_size: int = 128
    """What the policy sees (pixels)."""

    render_profile: str = "fast"
    """How that is drawn."""

    shown_size: int = 256
    """What is shown of each camera (pixels)."""

    seed: int = 500_000
    """Seed of the episode."""

    max_steps: int | None = None
    """Longest episode (control steps); the task's own where None."""

    every: int = 8
    """Every n-th control step is shown, at 20 pictures a second."""

    colors: int = 64
    """Colours of the palette."""


class Witness:
    """Passes actions on to environments, and keeps them."""

    def __init__(self, envs: Any) -> None:
        self._envs = envs
        self.actions: list[NDArray[np.float32]] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._envs, name)

    def step(self, actions: NDArray[np.float32]) -> Any:
        """Takes a step."""
        self.actions.append(actions[0].copy())
        return self._envs.step(actions)


def draw(config: GifConfig) -> None:
    """Runs the episode, draws it again, and writes the picture.

    Raises:
        BudsError: The episode failed: a picture of it would not show what was asked for.
    """
    (task,) = tasks_named(config.task)
    env = RobosuiteEnvConfig(task=config.task, image_size=config.image_size, render_profile=config.render_profile)
    env.episode_length = config.max_steps or task.max_steps
    checkpoint = load_checkpoint(config.policy_path, env, task, "cpu")
    ((envs,),) = (suite.values() for suite in env.create_envs(1, use_async_envs=True).values())
    recorder, witness = EpisodeRecorder(task, config.seed, keeps_pictures=False), Witness(envs)
    try:
        run_episodes(witness, checkpoint, Decider(checkpoint.policy), [recorder], lambda: None)  # type: ignore[arg-type]
    finally:
        envs.close()
    episode = recorder.episode()
    if not episode.success:
        raise BudsError(f"The episode of seed {config.seed} failed after {episode.length} steps; take another.")
    pictures = _drawn_again(config, witness.actions[: episode.length])
    n_skills = checkpoint.policy.config.n_skills or 1
    frames = list(episode_frames(episode, pictures, task.stages, FPS, n_skills))[:: config.every]
    _write(config, [Image.fromarray(frame) for frame in frames])
    print(f"{config.output}: {len(frames)} pictures, {config.output.stat().st_size / 1e6:.1f} MB")


def _drawn_again(config: GifConfig, actions: list[NDArray[np.float32]]) -> list[NDArray[np.uint8]]:
    env = RobosuiteEnv(EnvSettings(config.task, config.max_steps, config.shown_size, "full"))
    try:
        seen, _ = env.reset(seed=config.seed)
        pictures = [_both(seen)]
        for action in actions:
            seen, *_ = env.step(action)
            pictures.append(_both(seen))
    finally:
        env.close()
    return pictures


def _both(seen: Any) -> NDArray[np.uint8]:
    return np.concatenate(list(seen["pixels"].values()), axis=1)


def _write(config: GifConfig, images: list[Image.Image]) -> None:
    """Writes with one palette: colours that change from picture to picture flicker, and take room."""
    sample = Image.fromarray(np.concatenate([np.asarray(image) for image in images[:: len(images) // 8 or 1]]))
    palette = sample.quantize(config.colors)
    indexed = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    options = {"append_images": indexed[1:], "duration": 50, "loop": 0, "optimize": True, "save_all": True}
    write_atomically(config.output, lambda part: indexed[0].save(part, format="GIF", **options))


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
    config = parse(GifConfig)
    run(lambda: draw(config))
