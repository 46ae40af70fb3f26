"""A fake Hub in a process of its own, and a way to run Python that talks to it."""

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.request import Request, urlopen

import pytest

ROOT = Path(__file__).parents[2]

# huggingface_hub has the real Hub look a card over, wherever the card is going.
PRELUDE = "import huggingface_hub\nhuggingface_hub.RepoCard.validate = lambda *_, **__: None\n"


@dataclass
class FakeHub:
    """Where the fake Hub is, and how to use it.

    Attributes:
        address: For example ``http://127.0.0.1:1234``.
        home: What the clients have as ``HF_HOME``.
    """

    address: str
    home: Path

    def run(self, code: str, *arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
        """Runs Python code as a client of the Hub: the address is read at import, so it takes a process."""
        client = {
            "HF_ENDPOINT": self.address,
            "HF_HUB_OFFLINE": "0",
            "HF_HUB_DISABLE_XET": "1",
            "HF_HUB_DISABLE_TELEMETRY": "1",
            "HF_TOKEN": "hf_nobody",
            "HF_HOME": str(self.home),
            "HF_LEROBOT_HOME": str(self.home / "lerobot"),
            "PYTHONPATH": str(ROOT),
        }
        return subprocess.run(
            [sys.executable, "-c", PRELUDE + code, *map(str, arguments)],
            env={**os.environ, **client, **environment},
            capture_output=True,
            text=True,
            timeout=400,
        )

    def read(self, path: str) -> bytes:
        """Reads a file, for example ``me/model/resolve/main/README.md``."""
        with urlopen(f"{self.address}/{path}") as answer:
            return bytes(answer.read())

    def put(self, path: str, content: bytes) -> None:
        """Adds a file past all clients, for example to ``models/me/model/notes.txt``."""
        urlopen(Request(f"{self.address}/put/{path}", data=content, method="PUT")).close()

    def limit(self, count: int) -> None:
        """Lets so many more large files in, and refuses all others."""
        urlopen(Request(f"{self.address}/limit/{count}", method="PUT")).close()

    @property
    def received(self) -> int:
        """Bytes of files that have been sent to it."""
        return int(self.read("received"))


@pytest.fixture(scope="session")
def hub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FakeHub]:
    command = [sys.executable, str(Path(__file__).with_name("fake_hub.py"))]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield FakeHub(process.stdout.readline().strip(), tmp_path_factory.mktemp("hub"))
