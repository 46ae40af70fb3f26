"""The page's server: what it sends, and to whom. By requests as a browser makes them, and as it never would."""

import http.client
import json
import socket
import time
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lerobot_buds.core import ConfigError
from lerobot_buds.envs import ACTION_NAMES
from lerobot_buds.teleoperation.page import Page, open_page
from lerobot_buds.teleoperation.page_server import LARGEST_BODY, MOST_LOOKING_ON

IMAGES = {"agentview": np.full((32, 32, 3), 200, np.uint8), "eye_in_hand": np.zeros((16, 16, 3), np.uint8)}


@pytest.fixture
def page():
    opened = Page()
    opened.start()
    yield opened
    opened.stop()


def ask(page, path="/", method="GET", body=None, **headers):
    """One request, closed by the caller's exit; header names with _ for -."""
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=5)
    connection.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
    return connection.getresponse()


def say(page, path, content, **headers):
    return ask(page, path, "POST", json.dumps(content), X_Token=page.token, **headers)


def read_message(stream):
    body = stream.read(int.from_bytes(stream.read(4)))
    end = 4 + int.from_bytes(body[:4])
    header, at, images = json.loads(body[4:end]), end, {}
    for image in header.pop("images"):
        images[image["name"]] = np.array(Image.open(BytesIO(body[at : at + image["bytes"]])))
        at += image["bytes"]
    assert at == len(body)
    return header, images


def test_what_is_shown_arrives(page):
    with ask(page, "/stream", X_Token=page.token) as stream:
        assert read_message(stream) == ({"facts": {}, "held": [], "pressable": False}, {})
        page.on_press = print
        page.keys.say("me", 0, ["w", "shift"])
        page.show(IMAGES, {"task": "tool_use", "stages": {"fetch": True}})
        header, images = read_message(stream)
        while not images:  # what it says where nothing is new
            header, images = read_message(stream)
    assert header["facts"] == {"task": "tool_use", "stages": {"fetch": True}}
    assert header["held"] == ["shift", "w"] and header["pressable"] is True
    assert {name: image.shape for name, image in images.items()} == {n: i.shape for n, i in IMAGES.items()}
    assert all(np.abs(images[name].astype(int) - IMAGES[name]).max() < 4 for name in IMAGES)


def test_a_reader_that_is_slow_gets_the_newest(page):
    with ask(page, "/stream", X_Token=page.token) as stream:
        noise = np.random.default_rng(0).integers(0, 256, (512, 512, 3), np.uint8)
        for count in range(200):
            page.show({"agentview": noise}, {"n": count})
        numbers = []
        while 199 not in numbers:
            header, _ = read_message(stream)
            numbers.append(header["facts"].get("n", -1))
    assert len(numbers) < 100 and numbers == sorted(numbers)


def test_the_document_comes_with_the_token_alone(page):
    with ask(page, f"/?token={page.token}") as answer:
        text = answer.read().decode()
        assert answer.status == 200 and page.token not in text
        policy = answer.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy and "unsafe" not in policy and "frame-ancestors 'none'" in policy
    assert answer.headers["Cache-Control"] == "no-store" and answer.headers["Referrer-Policy"] == "no-referrer"
    assert "Access-Control-Allow-Origin" not in answer.headers and "Python" not in answer.headers["Server"]


STRANGERS = {
    "no token": {"token": ""},
    "another token": {"token": "x" * 32},
    "no letters": {"token": "\u00e9\u00ff"},
    "another origin": {"Origin": "http://example.com"},
    "another port's origin": {"Origin": "http://127.0.0.1:1"},
    "no origin": {"Origin": "null"},
    "another name": {"Host": "example.com"},
    "a name that leads here": {"Host": "127.0.0.1.example.com:{port}"},
    "no name": {"Host": ""},
    "another site's image": {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "no-cors"},
    "another port's image": {"Sec_Fetch_Site": "same-site", "Sec_Fetch_Mode": "no-cors"},
}


@pytest.mark.parametrize("stranger", STRANGERS)
@pytest.mark.parametrize("path", ["/", "/stream", "/keys", "/press"])
def test_strangers_get_nothing(page, path, stranger):
    pressed = []
    page.on_press = pressed.append
    page.show(IMAGES, {})
    headers = {name: value.replace("{port}", str(page.port)) for name, value in STRANGERS[stranger].items()}
    token = headers.pop("token", page.token)
    content = {"/keys": {"page": "x", "number": 0, "held": ["w"]}, "/press": {"name": "next"}}.get(path)
    query = "".join(f"%{byte:02x}" for byte in token.encode())
    with ask(
        page,
        f"/?token={query}" if path == "/" else path,
        "POST" if content else "GET",
        json.dumps(content) if content else None,
        X_Token=token.encode("latin-1"),
        **headers,
    ) as answer:
        assert answer.status == 403 and answer.read() == b""  # in this order: a stream has no end
    assert not page.held() and not pressed


def test_a_link_of_another_site_leads_to_the_page_but_to_nothing_else(page):
    link = {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate"}
    with ask(page, f"/?token={page.token}", **link) as answer:
        assert answer.status == 200
    with ask(page, "/stream", X_Token=page.token, **link) as answer:
        assert answer.status == 403


def test_through_a_tunnel_with_another_port_it_answers(page):
    here = {"Host": "localhost:9999", "Origin": "http://localhost:9999", "Sec_Fetch_Site": "same-origin"}
    with say(page, "/keys", {"page": "x", "number": 0, "held": ["w"]}, **here) as answer:
        assert answer.status == 204
    assert page.held() == {"w"}


@pytest.mark.parametrize(
    ("path", "body", "status"),
    [
        ("/keys", "{}", 400),
        ("/keys", "[1]", 400),
        ("/keys", "{", 400),
        ("/keys", '{"page": "x", "number": "many", "held": ["w"]}', 400),
        ("/keys", '{"page": "x", "number": 0, "held": 3}', 400),
        ("/keys", '{"page": "x", "number": 1e999, "held": ["w"]}', 400),
        ("/keys", "[" * 2000, 400),
        ("/keys", "\xff", 400),
        ("/press", '{"name": "format"}', 400),
        ("/press", '{"name": ["next"]}', 400),
        ("/press", '{"name": "next"}', 409),
        ("/stream", "{}", 400),
        ("/keys", " " * (LARGEST_BODY + 1), 413),
    ],
)
def test_what_makes_no_sense_is_refused(page, path, body, status):
    with ask(page, path, "POST", body.encode("latin-1"), X_Token=page.token) as answer:
        assert (answer.status, answer.read()) == (status, b"")
    assert not page.held()


def test_an_address_that_is_none_is_refused(page):
    with socket.create_connection(("127.0.0.1", page.port), timeout=5) as connection:
        connection.sendall(b"GET http://[bad/ HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert b" 400 " in connection.recv(4096)


def test_a_body_of_unknown_length_is_not_read(page):
    with socket.create_connection(("127.0.0.1", page.port), timeout=5) as connection:
        head = f"POST /keys HTTP/1.1\r\nHost: localhost\r\nX-Token: {page.token}\r\nTransfer-Encoding: chunked\r\n\r\n"
        connection.sendall(head.encode() + b"5\r\nhello\r\n")
        assert b" 413 " in connection.recv(4096)


def test_buttons_are_pressed(page):
    pressed = []
    page.on_press = pressed.append
    for name in ("next", "re-record", "stop"):
        with say(page, "/press", {"name": name}) as answer:
            assert answer.status == 204
    assert pressed == ["next", "re-record", "stop"]


def test_not_everybody_may_look_on_at_once(page):
    streams = [ask(page, "/stream", X_Token=page.token) for _ in range(MOST_LOOKING_ON)]
    with ask(page, "/stream", X_Token=page.token) as answer:
        assert answer.status == 503
    for stream in streams:
        stream.close()
    deadline = time.monotonic() + 10
    while ask(page, "/stream", X_Token=page.token).status == 503:
        assert time.monotonic() < deadline, "who went away keeps a place"
        time.sleep(0.1)


def listening(port):
    """Local addresses, in the kernel's notation, of the sockets that listen on a port."""
    rows = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    return [row[1].partition(":")[0] for row in rows if row[3] == "0A" and int(row[1].rpartition(":")[2], 16) == port]


def test_nothing_listens_beyond_loopback(page):
    assert listening(page.port) == ["0100007F"]  # 127.0.0.1, and no other address
    port = page.port
    page.stop()
    page.stop()
    assert listening(port) == [] and open_page() is None


def test_one_page_a_process_each_with_a_token_of_its_own(page):
    assert open_page() is page and page.address.endswith(page.token) and len(page.token) == 32
    with pytest.raises(ConfigError, match="has a page already"):
        Page().start()
    former = page.token
    page.stop()
    other = Page(page.port)
    other.start()
    assert other.token != former and other.port == page.port
    other.stop()


def test_a_port_that_is_taken(hand):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=rf"port {port}.*--teleop.port"):
            hand(device="page", port=port).connect()
    assert open_page() is None


def test_a_hand_opens_it_and_moves_by_its_keys(hand, caplog):
    held = hand(device="page", port=0)
    assert open_page() is None
    with caplog.at_level("INFO"):
        held.connect()
    assert f"http://127.0.0.1:{open_page().port}/?token={open_page().token}" in caplog.text
    open_page().keys.say("me", 0, ["d"])
    assert held.get_action() == dict(zip(ACTION_NAMES, [0.0, 0.625, 0.0, -1.0], strict=True))
    held.disconnect()
    assert open_page() is None
