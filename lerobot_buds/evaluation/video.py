"""The video of an episode: both cameras, and under them the ribbon of its skills. Imports Pillow and PyAV on use."""

from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import write_atomically
from lerobot_buds.segmentation.timeline import label_colors

from .trace import Episode

if TYPE_CHECKING:
    from PIL.Image import Image

Picture = NDArray[np.uint8]

_WIDTH = 512
"""Pixels that a video is wide at least; smaller pictures are enlarged."""

_BAND = 72
_MARGIN = 8
_STRIP = (32, 50)  # rows of the ribbon within the band, half-open
_BACK, _FORE, _DIM = (24, 24, 28), (236, 236, 236), (150, 150, 156)
_TO_COME = 0.35  # how strong the colour of what is to come is
_FONT = 15


class RibbonBand:
    """Draws the band under a video: what is done now, the ribbon of the whole episode, and when stages were done.

    Args:
        episode: The episode, of at least one control step.
        stages: Names of the task's stages.
        fps: Control steps per second.
        n_skills: Number of skills.
        width: Width of the band (pixels).
    """

    def __init__(self, episode: Episode, stages: Sequence[str], fps: float, n_skills: int, width: int) -> None:
        self._episode, self._stages, self._fps, self._width = episode, stages, fps, width
        shades = np.array(list(label_colors(range(n_skills), "skills").values()))[:, :3] * 255
        self._colors = shades.astype(np.uint8)
        self._labels = episode.labels
        columns = np.linspace(0, len(self._labels), width - 2 * _MARGIN, endpoint=False).astype(np.int64)
        self._strip = self._colors[self._labels[columns]]  # (W, 3)
        self._faint = (_TO_COME * self._strip + (1 - _TO_COME) * np.array(_BACK)).astype(np.uint8)

    def at(self, step: int) -> Picture:
        """Draws the band after so many control steps, ``(72, width, 3)`` uint8."""
        from PIL import Image

        band = np.full((_BAND, self._width, 3), _BACK, dtype=np.uint8)
        cursor = self._column(step)
        top, bottom = _STRIP
        strip = band[top:bottom, _MARGIN : self._width - _MARGIN]
        strip[:] = self._faint
        strip[:, : cursor - _MARGIN] = self._strip[: cursor - _MARGIN]
        band[top - 4 : bottom + 4, cursor - 1 : cursor + 1] = _FORE
        image = Image.fromarray(band)
        self._write(image, step)
        drawn: Picture = np.asarray(image)
        return drawn

    def _write(self, image: "Image", step: int) -> None:
        from PIL.ImageDraw import Draw
        from PIL.ImageFont import load_default

        draw, font, small = Draw(image), load_default(_FONT), load_default(_FONT - 4)
        skill = int(self._labels[min(step, len(self._labels) - 1)])
        draw.rounded_rectangle((_MARGIN, 6, _MARGIN + 68, 26), radius=4, fill=tuple(self._colors[skill].tolist()))
        draw.text((_MARGIN + 34, 16), f"skill {skill}", fill="white", font=font, anchor="mm")
        draw.text((_MARGIN + 80, 16), f"{step / self._fps:.1f} s", fill=_FORE, font=font, anchor="lm")
        draw.text((self._width - _MARGIN, 16), self._news(step), fill=_FORE, font=font, anchor="rm")
        for number, done in enumerate(self._episode.stage_steps, start=1):
            if done is not None:
                x, color = self._column(done), _FORE if done <= step else _DIM
                draw.polygon([(x, _STRIP[1] + 2), (x - 4, _STRIP[1] + 8), (x + 4, _STRIP[1] + 8)], fill=color)
                draw.text((x, _BAND - 7), str(number), fill=color, font=small, anchor="mm")

    def _news(self, step: int) -> str:
        """Words the state of things: how it ended, or which stage was done last."""
        if step >= len(self._labels):
            return "lost to an error" if self._episode.error else "success" if self._episode.success else "failed"
        done = [(at, name) for at, name in zip(self._episode.stage_steps, self._stages, strict=True) if at is not None]
        past = [(at, name) for at, name in done if at <= step]
        return f"{max(past)[1]} done" if past else ""

    def _column(self, step: int) -> int:
        inner = self._width - 2 * _MARGIN
        return _MARGIN + round(inner * min(step / len(self._labels), 1.0))


def episode_frames(
    episode: Episode, pictures: Sequence[Picture], stages: Sequence[str], fps: float, n_skills: int
) -> Iterator[Picture]:
    """Draws the frames of an episode's video, one at a time.

    Args:
        episode: The episode, of at least one control step.
        pictures: ``(H, W, 3)`` uint8 before every control step and at the end.
        stages: Names of the task's stages.
        fps: Control steps per second.
        n_skills: Number of skills.

    Yields:
        Frames of one size, even as video needs it.
    """
    _, width, _ = pictures[0].shape
    factor = -(-_WIDTH // width)
    band = RibbonBand(episode, stages, fps, n_skills, factor * width)
    for step, picture in enumerate(pictures):
        frame = np.concatenate([picture.repeat(factor, axis=0).repeat(factor, axis=1), band.at(step)])
        yield frame[: len(frame) // 2 * 2, : factor * width // 2 * 2]


def write_video(path: Path, frames: Iterable[Picture], fps: float) -> None:
    """Writes frames as MP4 (H.264), atomically; like LeRobot's own writer, but without holding them all at once.

    Args:
        path: The file to create or replace.
        frames: ``(H, W, 3)`` uint8, H and W even, all of one size.
        fps: Frames per second.
    """
    import av

    def write(part: Path) -> None:
        with av.open(str(part), "w", format="mp4") as container:  # the part's name does not tell the format
            stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))  # 29.97 as well
            stream.pix_fmt = "yuv420p"
            for frame in frames:
                stream.height, stream.width = frame.shape[:2]
                container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
            container.mux(stream.encode())

    write_atomically(path, write)
