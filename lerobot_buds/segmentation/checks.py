"""Refuses latents and segments that skill discovery cannot work with, and says where the fault is."""

from collections.abc import Sequence

import numpy as np

from lerobot_buds.core import FloatArray, IntArray, SegmentationError


def checked_latents(latents: Sequence[FloatArray]) -> list[FloatArray]:
    """Makes float64 arrays of the latents of every demonstration, ``(T, D)`` each.

    Raises:
        SegmentationError: There are no frames, shapes differ, or a latent is not finite.
    """
    episodes = [np.asarray(episode, dtype=np.float64) for episode in latents]
    if not any(len(episode) for episode in episodes):
        raise SegmentationError("There are no demonstrations to segment: no episode has any frame.")
    dims = episodes[0].shape[1:]
    for number, episode in enumerate(episodes):
        if episode.ndim != 2 or episode.shape[1:] != dims or dims[0] == 0:
            raise SegmentationError(
                f"The latents of episode {number} have shape {episode.shape}; (frames, dimensions) was expected, with "
                f"the dimensions of episode 0, {episodes[0].shape}."
            )
        bad = np.argwhere(~np.isfinite(episode))
        if len(bad):
            frame, dim = bad[0]
            raise SegmentationError(
                f"The latent of episode {number}, frame {frame}, dimension {dim} is {episode[frame, dim]} "
                f"({len(bad)} such values in this episode). Check the episode's frames, or train the representation "
                "again."
            )
    return episodes


def tiling(episodes: Sequence[FloatArray], segments: Sequence[IntArray]) -> list[IntArray]:
    """Passes on the spans of every demonstration, ``(S, 2)`` each.

    Raises:
        SegmentationError: They do not tile the demonstrations.
    """
    if len(segments) != len(episodes):
        raise SegmentationError(
            f"There are segments of {len(segments)} demonstrations, but latents of {len(episodes)}."
        )
    for number, (episode, bounds) in enumerate(zip(episodes, segments, strict=True)):
        edges = [0, *bounds[:, 1].tolist()]
        if bounds[:, 0].tolist() != edges[:-1] or edges[-1] != len(episode) or (np.diff(edges) < 1).any():
            raise SegmentationError(
                f"The segments of demonstration {number} do not tile its {len(episode)} frames: {bounds.tolist()}."
            )
    return list(segments)
