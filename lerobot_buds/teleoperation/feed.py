"""The newest images and facts, as messages for whoever looks on. Who is slow misses some; nobody holds up the robot.

A message is a length (4 bytes, most significant first), a header of that length in JSON, and the JPEGs that its
``images`` list with name and number of bytes. Before it stands the length of all that, in 4 bytes, too.
"""

import json
import threading
from collections.abc import Mapping
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

QUALITY = 90
"""Of the JPEGs, out of 100."""


class Feed:
    """One writer, any number of readers."""

    def __init__(self) -> None:
        self._news = threading.Condition()
        self._number, self._ended = 0, False
        self._images: dict[str, NDArray[np.uint8]] = {}
        self._facts: Mapping[str, Any] = {}

    def show(self, images: Mapping[str, NDArray[np.uint8]], facts: Mapping[str, Any]) -> None:
        """Puts something new in the place of what was shown.

        Args:
            images: ``(H, W, 3)`` uint8 by name, in the order of the page. They are copied.
            facts: Plain data.
        """
        copies = {name: np.array(image) for name, image in images.items()}
        with self._news:
            self._number, self._images, self._facts = self._number + 1, copies, dict(facts)
            self._news.notify_all()

    def end(self) -> None:
        """Tells readers that nothing more comes."""
        with self._news:
            self._ended = True
            self._news.notify_all()

    def after(self, seen: int, patience: float) -> tuple[int, dict[str, NDArray[np.uint8]], Mapping[str, Any]] | None:
        """Waits for something newer.

        Args:
            seen: Number of what the reader has seen; 0 for nothing.
            patience: How long to wait at most (s).

        Returns:
            Its number, images and facts: no images, and the number as it was, where nothing new came. None after the
            end.
        """
        with self._news:
            self._news.wait_for(lambda: self._ended or self._number > seen, patience)
            if self._ended:
                return None
            return self._number, self._images if self._number > seen else {}, self._facts


def message(images: Mapping[str, NDArray[np.uint8]], header: Mapping[str, Any]) -> bytes:
    """Packs images and facts, see the module."""
    jpegs = {name: _jpeg(image) for name, image in images.items()}
    listed = [{"name": name, "bytes": len(jpeg)} for name, jpeg in jpegs.items()]
    text = json.dumps({**header, "images": listed}).encode()
    body = len(text).to_bytes(4) + text + b"".join(jpegs.values())
    return len(body).to_bytes(4) + body


def _jpeg(image: NDArray[np.uint8]) -> bytes:
    buffer = BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", quality=QUALITY)
    return buffer.getvalue()
