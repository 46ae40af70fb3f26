"""Small pictures of frames inside the page, as WebP in data URIs."""

from base64 import b64encode
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from lerobot_buds.core import WORKSPACE_CAMERA, IntArray
from lerobot_buds.data import LocalDataset, cached_frames, frame_size, used_size

if TYPE_CHECKING:
    from PIL.Image import Image

BUDGET = 6000
"""Pictures in all strips together."""

MOST, LEAST = 16, 4
"""Pictures in one strip."""

HEIGHT = 80
"""Height of a picture in a strip (pixels); smaller frames stay as they are."""

QUALITIES = (60, 40, 20, 5)
"""Of WebP, out of 100: the first that keeps a picture within `BYTES`; 60 for all but noise."""

BYTES = 2600
"""Most bytes of a picture in a strip: with `BUDGET` of them, a page of 21 MB (base64 takes a third more)."""


class Pictures:
    """Pictures of the cameras of a dataset: of all cameras, or of the first alone where there are too many episodes.

    Args:
        dataset: The dataset; its frames are decoded into the frame store where they are not there yet.
        side: Side of the squares in the frame store (pixels).
        episodes: Number of episodes that are shown.

    Attributes:
        cameras: The cameras, that of the workspace first.
        sizes: Width and height of a picture of each (pixels).
        count: Pictures in one strip.
    """

    def __init__(self, dataset: LocalDataset, side: int, episodes: int) -> None:
        most = max(1, BUDGET // (LEAST * episodes))
        self.cameras = sorted(dataset.cameras, key=lambda name: name != WORKSPACE_CAMERA)[:most]
        strips = max(1, len(self.cameras) * episodes)
        self.count = min(MOST, max(LEAST, BUDGET // strips))
        self.sizes: dict[str, tuple[int, int]] = {}
        self._frames = {}
        for camera in self.cameras:
            height, width = frame_size(dataset.features[camera], camera)
            shown = min(height, HEIGHT)
            self.sizes[camera] = (max(1, round(width * shown / height)), shown)
            self._frames[camera] = cached_frames(dataset, camera, size=used_size((height, width), side))

    def strip(self, camera: str, start: int, length: int) -> str:
        """Makes one picture of `count` frames side by side, each from the middle of its part of an episode.

        Args:
            camera: Name of the camera.
            start: Absolute index of the episode's first frame.
            length: Its number of frames.
        """
        from PIL import Image

        width, height = self.sizes[camera]
        strip = Image.new("RGB", (width * self.count, height))
        for place, frame in enumerate(middles(length, self.count).tolist()):
            strip.paste(self.image(camera, start + frame), (width * place, 0))
        return data_uri(strip, BYTES * self.count)

    def frame(self, camera: str, index: int) -> str:
        """Makes a picture of one frame, by its absolute index."""
        return data_uri(self.image(camera, index), BYTES)

    def image(self, camera: str, index: int) -> "Image":
        """Reads one frame, by its absolute index, in the shape of its camera and at most `HEIGHT` high."""
        from PIL import Image

        # The store's squares get back the shape of the camera.
        frame = np.ascontiguousarray(self._frames[camera][index].transpose(1, 2, 0))
        return Image.fromarray(frame).resize(self.sizes[camera], Image.Resampling.LANCZOS)


def middles(length: int, count: int) -> IntArray:
    """Lists the middle frames of `count` equal parts of ``[0, length)``; some repeat where it is shorter than that."""
    frames: IntArray = ((2 * np.arange(count) + 1) * length // (2 * count)).astype(np.int64)
    return frames


def data_uri(image: "Image", most: int) -> str:
    """Makes an image part of a page, by a lower quality where it would take more than so many bytes."""
    for quality in QUALITIES:
        buffer = BytesIO()
        image.save(buffer, "WEBP", quality=quality, method=4)
        if buffer.tell() <= most:
            break
    return f"data:image/webp;base64,{b64encode(buffer.getvalue()).decode()}"
