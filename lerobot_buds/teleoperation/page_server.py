"""What the page's server answers, and to whom: to this machine alone, and only to who has the token.

A web site that the user visits meanwhile can send requests to this address, too. It does not have the token; and what
comes from another origin, or by another name than this machine's own (a site's name that suddenly leads here), is
refused whatever it holds.
"""

import json
import logging
import sys
from base64 import b64encode
from functools import cached_property
from hashlib import sha256
from hmac import compare_digest
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socketserver import TCPServer
from threading import Semaphore
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from lerobot_buds.envs import FPS

from .feed import message
from .layout import BUTTONS, KEYS, RECORDING, SLOW_KEY

if TYPE_CHECKING:
    from .page import Page

WEB = Path(__file__).parent / "web"
OUR_NAMES = {"127.0.0.1", "localhost"}
LARGEST_BODY = 2048
"""What may be sent at once (bytes): the names of all keys take 200."""

MOST_LOOKING_ON = 8
PATIENCE_S = 0.25
"""How long the stream is silent at most (s); the page takes 3 s of silence for a lost connection."""

logger = logging.getLogger(__name__)


class PageServer(ThreadingHTTPServer):
    """Listens on the loopback address.

    Args:
        page: What is served.

    Raises:
        OSError: The port is taken.
    """

    daemon_threads = True

    def __init__(self, page: "Page") -> None:
        self.page, self.places = page, Semaphore(MOST_LOOKING_ON)
        super().__init__(("127.0.0.1", page.port), _Handler)

    def server_bind(self) -> None:
        """Binds without asking a name server what this machine is called, as its parent would."""
        TCPServer.server_bind(self)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Says what went wrong in a request; that a browser went away is nothing wrong."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            logger.error("The page could not answer.", exc_info=True)

    @cached_property
    def document(self) -> tuple[bytes, str]:
        """The page, and the policy by which a browser runs its script and no other."""
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
        from markupsafe import Markup

        script, style = ((WEB / f"page.{kind}").read_text(encoding="utf-8") for kind in ("js", "css"))
        templates = Environment(loader=FileSystemLoader(WEB), autoescape=True, undefined=StrictUndefined)
        text = templates.get_template("page.html.j2").render(
            script=Markup(script),
            style=Markup(style),
            keys=KEYS,
            slow_key=SLOW_KEY,
            settings={"buttons": BUTTONS, "recording": RECORDING, "fps": FPS},
        )
        allowed = {"script-src": _hash(script), "style-src": _hash(style), "connect-src": "'self'", "img-src": "data:"}
        rules = "; ".join(f"{kind} {source}" for kind, source in allowed.items())
        return (
            text.encode(),
            f"default-src 'none'; {rules}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
        )


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "page", ""
    timeout = 10  # seconds, for a browser that neither reads nor writes
    disable_nagle_algorithm = True
    server: PageServer

    def do_GET(self) -> None:
        """Serves the page, and its stream."""
        try:
            parts = urlsplit(self.path)
        except ValueError:
            return self._refuse(HTTPStatus.BAD_REQUEST)
        if parts.path == "/" and self._admits(parse_qs(parts.query).get("token", [""])[0], navigating=True):
            document, policy = self.server.document
            headers = {"Content-Type": "text/html; charset=utf-8", "Content-Security-Policy": policy}
            return self._answer(HTTPStatus.OK, document, headers)
        if parts.path == "/stream" and self._admits(self.headers.get("X-Token", "")):
            return self._stream()
        return self._refuse(HTTPStatus.FORBIDDEN)

    def do_POST(self) -> None:
        """Takes in keys that are held, and buttons that are pressed."""
        if not self._admits(self.headers.get("X-Token", "")):
            return self._refuse(HTTPStatus.FORBIDDEN)
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > LARGEST_BODY:
            return self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        try:
            said = json.loads(self.rfile.read(int(length)))
            status = self._take(said) if isinstance(said, dict) else HTTPStatus.BAD_REQUEST
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
            status = HTTPStatus.BAD_REQUEST
        return self._answer(status)

    def _take(self, said: dict[str, Any]) -> HTTPStatus:
        """Does what a message asks for.

        Raises:
            KeyError: Something is missing in it.
            TypeError, ValueError: Something is not what it should be.
        """
        page = self.server.page
        if self.path == "/keys":
            page.keys.say(str(said["page"])[:40], int(said["number"]), [str(key) for key in said["held"]])
            return HTTPStatus.NO_CONTENT
        if self.path != "/press" or said["name"] not in BUTTONS:
            return HTTPStatus.BAD_REQUEST
        if page.on_press is None:
            return HTTPStatus.CONFLICT
        page.on_press(said["name"])
        return HTTPStatus.NO_CONTENT

    def _admits(self, token: str, navigating: bool = False) -> bool:
        """Tells whether this request comes from our own page, or from somebody who types its address."""
        host = self.headers.get("Host", "")
        if host.partition(":")[0] not in OUR_NAMES:
            return False
        if self.headers.get("Origin", f"http://{host}") != f"http://{host}":
            return False
        # Said by browsers alone, which send no origin with an image or a link. A link may lead to the page.
        site, mode = self.headers.get("Sec-Fetch-Site", "none"), self.headers.get("Sec-Fetch-Mode", "")
        if site not in ("none", "same-origin") and not (navigating and mode == "navigate"):
            return False
        return compare_digest(token.encode(), self.server.page.token.encode())

    def _stream(self) -> None:
        """Sends what is shown as long as somebody looks on."""
        if not self.server.places.acquire(blocking=False):
            return self._refuse(HTTPStatus.SERVICE_UNAVAILABLE)
        try:
            self.close_connection = True  # its end is the end of the stream
            self.send_response(HTTPStatus.OK)
            self._send_headers({"Content-Type": "application/octet-stream", "Connection": "close"})
            page, seen = self.server.page, 0
            while (news := page.feed.after(seen, PATIENCE_S)) is not None:
                seen, images, facts = news
                header = {"facts": facts, "held": sorted(page.held()), "pressable": page.on_press is not None}
                self.wfile.write(message(images, header))
        finally:
            self.server.places.release()

    def _refuse(self, status: HTTPStatus) -> None:
        """Answers nothing but a number, and hangs up: what else was sent is not read."""
        self.close_connection = True
        self._answer(status, headers={"Connection": "close"})

    def _answer(self, status: HTTPStatus, body: bytes = b"", headers: dict[str, str] | None = None) -> None:
        self.send_response(status)
        length = {} if status is HTTPStatus.NO_CONTENT else {"Content-Length": str(len(body))}
        self._send_headers({**length, **(headers or {})})
        self.wfile.write(body)

    def _send_headers(self, headers: dict[str, str]) -> None:
        always = {
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cross-Origin-Opener-Policy": "same-origin",
        }
        for name, value in {**always, **headers}.items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Logs nothing: the addresses hold the token."""


def _hash(text: str) -> str:
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'"
