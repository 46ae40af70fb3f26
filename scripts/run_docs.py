"""Runs the commands of a document one after the other, as somebody does who follows it from top to bottom.

    python scripts/run_docs.py README.md                  # a quarter of an hour on two cores
    python scripts/run_docs.py docs/report.md --list

Run are commands of this package and of LeRobot in fenced blocks, in an empty folder that has `configs`; the rest
(installing, `make`, containers) is left to whoever runs this, as are blocks under a comment that says what they need,
``<!-- needs: a dataset of yours -->``. The first that fails ends it. `tests/test_commands.py`
checks the same commands of all documents without running them.
"""

import argparse
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]

_FENCE = re.compile(r"(<!-- needs: .*? -->\n+)?^( *)```(\w*)\n(.*?)^\2```", flags=re.M | re.S)


def commands(path: Path, runnable: bool = False) -> Iterator[list[str]]:
    """Reads the commands in the fenced blocks of a document, in words; blocks of output have none.

    Args:
        path: The document.
        runnable: Leaves out blocks that need something.
    """
    for need, _, language, block in _FENCE.findall(path.read_text(encoding="utf-8")):
        if need and runnable:
            continue
        for line in re.sub(r"\\\n\s*", " ", block).splitlines():
            if language in ("", "bash", "sh") and re.match(r"(lerobot-|make |python |accelerate )", line.strip()):
                yield shlex.split(line, comments=True)


def main() -> None:
    """Runs them, or lists what would be run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("document", type=Path)
    parser.add_argument("--folder", type=Path, default=Path("outputs/run_docs"), help="where to run them")
    parser.add_argument("--list", action="store_true", help="only lists them")
    chosen = parser.parse_args()

    found = [words for words in commands(chosen.document, runnable=True) if words[0].startswith("lerobot-")]
    if chosen.list:
        print(*map(shlex.join, found), sep="\n")
        return
    if chosen.folder.exists():
        parser.error(f"{chosen.folder} exists already: remove it, or name another folder with --folder")
    chosen.folder.mkdir(parents=True)
    (chosen.folder / "configs").symlink_to(ROOT / "configs")
    for program, *arguments in found:
        began = time.monotonic()
        done = subprocess.run([Path(sys.executable).with_name(program), *arguments], cwd=chosen.folder)
        print(f"run_docs: {time.monotonic() - began:.0f} s, status {done.returncode}: {program}", flush=True)
        if done.returncode:
            sys.exit(done.returncode)


if __name__ == "__main__":
    main()
