"""A page in the browser to teleoperate from where there is no display: cameras, stages, and keys that go back.

It listens on this machine's own address alone and answers nobody without its token. From another machine it is reached
through ``ssh -L``. A robot shows to it what it sees, once an observation:

    if page := open_page():
        page.on_press = press
        page.show(images, facts)
"""

import logging
import secrets
import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import ConfigError

from .feed import Feed
from .held_keys import HeldKeys
from .layout import KEYS, SLOW_KEY

logger = logging.getLogger(__name__)
_opened: list["Page"] = []


class Page:
    """A web server in a thread of this process.

    Args:
        port: Where it listens; 0 for any port that is free.

    Attributes:
        token: What an address must hold to be answered; another one every time.
        feed: What is shown.
        keys: What is held.
        on_press: Is called with a name of `layout.BUTTONS` when a button is pressed, in a thread of the page's. There
            are buttons only while it is set.
    """

    def __init__(self, port: int = 0) -> None:
        self.port, self.token = port, secrets.token_urlsafe(24)
        self.feed, self.keys = Feed(), HeldKeys(KEYS.keys() | {SLOW_KEY})
        self.on_press: Callable[[str], object] | None = None
        self._server: Any = None
        self._thread: threading.Thread | None = None

    @property
    def address(self) -> str:
        """The address to open, with the token."""
        return f"http://127.0.0.1:{self.port}/?token={self.token}"

    def start(self) -> None:
        """Begins to listen, and logs the address.

        Raises:
            ConfigError: The port is taken, or this process has a page already.
        """
        from .page_server import PageServer

        if _opened:
            raise ConfigError("This process has a page already; there is one person at the controls.")
        try:
            self._server = PageServer(self)
        except OSError as error:
            raise ConfigError(
                f"The page cannot be served on port {self.port} of this machine ({error.strerror}). Choose another "
                "--teleop.port; 0 takes any that is free."
            ) from error
        self.port = self._server.server_address[1]
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), name="page", daemon=True)
        self._thread.start()
        _opened.append(self)
        logger.info("The page is open: %s", self.address)

    def stop(self) -> None:
        """Ends it; may be called twice."""
        if self._server is not None:
            _opened.remove(self)
            self.feed.end()
            self._server.shutdown()
            self._server.server_close()
            self._server = None

    def show(self, images: Mapping[str, NDArray[np.uint8]], facts: Mapping[str, Any]) -> None:
        """Shows what the robot sees; costs a copy of the images.

        Args:
            images: ``(H, W, 3)`` uint8 by the camera's name.
            facts: Plain data, all of it optional: ``task`` (str), ``seed`` (int), ``phase`` (``free``, ``episode``,
                ``reset``, ``paused`` or ``correction``), ``episodes`` (int: how many are saved), ``steps`` (int),
                ``succeeded`` (bool), ``stages`` (``{name: whether it is done}``) and ``buttons`` (names of
                `layout.BUTTONS` to offer; those of a recording by default).
        """
        self.feed.show(images, facts)

    def held(self) -> set[str]:
        """Returns the names of the keys that are held in it now, see `layout.KEYS`."""
        return self.keys.now()


def open_page() -> Page | None:
    """Returns the page that is open in this process, for a robot to show to."""
    return _opened[0] if _opened else None
