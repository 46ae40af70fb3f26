"""Packs what a GPU node without internet needs into parts that can be carried there.

    python scripts/offline_bundle.py --output_dir=outputs/bundle
    python scripts/offline_bundle.py --output_dir=outputs/bundle --part_mib=1000 --recordings='[outputs/serve]'

The node has Linux on x86_64 with glibc 2.28 or newer, Python 3.12 and, unless ``--with_torch=true``, torch. There,
``./install.sh FOLDER`` joins the parts, installs them and checks what came out (docs/install.md). The project is packed
as it was last committed. The folder appears when all of it is there; pip's cache spares a run that was cut off most
downloads.
"""

import io
import logging
import re
import shutil
import subprocess
import sys
import tarfile
from base64 import urlsafe_b64encode
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from fnmatch import fnmatch
from hashlib import sha256
from pathlib import Path
from typing import BinaryIO
from zipfile import ZipFile

from packaging.requirements import Requirement
from packaging.utils import parse_wheel_filename

from lerobot_buds.cli.running import parse, run
from lerobot_buds.core import (
    BudsError,
    ConfigError,
    StorageError,
    near_names,
    remove_leftovers,
    sha256_of_file,
    staged_directory,
    write_json,
)
from lerobot_buds.data.writing import only_writer

PROJECT = Path(__file__).parents[1]
INSTALLER = PROJECT / "scripts/offline_install.sh"

COMPANIONS = ("torchvision", "torchcodec")
"""Built for one version of torch, and small: they travel, and are installed where the node has that version alone."""

HEAVY = ("torch", "triton", "nvidia-*", "cuda-*")
"""What a node with torch has: torch itself and what it needs of a GPU: 2.5 GiB."""

PLATFORMS = (
    *("linux_x86_64", "manylinux1_x86_64", "manylinux2010_x86_64", "manylinux2014_x86_64"),
    *(f"manylinux_2_{minor}_x86_64" for minor in range(5, 29)),
)
"""Wheels that run with glibc 2.28, of 2018; pip takes every name literally."""

ASSETS = "robosuite/models/assets/"
USED_ASSETS = (
    *("base.xml", "arenas/*", "objects/*", "textures/*", "robots/panda/*"),
    *("grippers/panda_gripper.xml", "grippers/meshes/panda_gripper/*"),
    *("bases/rethink_mount.xml", "bases/meshes/rethink_mount/pedestal.stl"),
)
"""What the tasks load of robosuite's 512 MB of assets; the rest are other robots, hands and bases."""


@dataclass
class BundleConfig:
    """Settings of a bundle."""

    output_dir: Path
    """Folder to make."""

    part_mib: int = 60
    """Size of a part (MiB); the last one is smaller."""

    with_torch: bool = False
    """Packs torch and its CUDA libraries too, for nodes that have none: 2.5 GiB more."""

    leave_out: list[str] = field(default_factory=list)
    """Further packages to leave out, by name: ``[cmake, wandb]``, 53 MiB, are needed by no experiment."""

    recordings: list[Path] = field(default_factory=list)
    """Folders to take along, such as datasets; they come to lie under ``recordings``, by their own names."""


def bundle(config: BundleConfig) -> None:
    """Makes the folder.

    Raises:
        BudsError: A setting cannot work, or a command failed; nothing was left behind.
    """
    recordings = _recordings(config.recordings)
    if config.part_mib < 1:
        raise ConfigError(f"part_mib={config.part_mib} must be at least 1.")
    with only_writer(config.output_dir):
        if config.output_dir.exists():
            raise ConfigError(f"{config.output_dir} exists; remove it, or choose another --output_dir.")
        remove_leftovers(config.output_dir.parent, config.output_dir.name)
        with staged_directory(config.output_dir) as staging:
            content = staging / "content"
            commit, time = export_project(content / "project")
            locked = locked_requirements(content / "project")
            wheels = collect_wheels(choose(locked, config), content / "wheels")
            wheels.append(_build(content / "project", content / "wheels"))
            _write_requirements(content, wheels, {} if config.with_torch else locked)
            folders = {path.name: path for path in sorted(content.iterdir())} | recordings
            write_parts(folders, staging, config.part_mib << 20, time)
            shutil.rmtree(content)
            shutil.copy(INSTALLER, staging / "install.sh")
            described = {"commit": commit, "wheels": sorted(w.name for w in wheels), "recordings": sorted(recordings)}
            write_json(staging / "bundle.json", described)
            write_sums(staging)
    parts = sorted(config.output_dir.glob("part.*"))
    size = sum(part.stat().st_size for part in parts) / 2**20
    print(f"{config.output_dir}: {len(parts)} parts, {size:.0f} MiB, {len(wheels)} wheels")


def export_project(folder: Path) -> tuple[str, int]:
    """Writes the checkout as it was last committed; returns the commit and its time (seconds since 1970)."""
    if changes := _output("git", "status", "--porcelain", "--untracked-files=no"):
        logging.warning("What is not committed is not packed:\n%s", changes.rstrip())
    archive = subprocess.run(["git", "archive", "HEAD"], cwd=PROJECT, capture_output=True, check=True).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        tar.extractall(folder, filter="data")
    commit, time = _output("git", "show", "--no-patch", "--format=%H %ct", "HEAD").split()
    return commit, int(time)


def locked_requirements(project: Path) -> dict[str, str]:
    """Reads what ``uv.lock`` names for this package with its simulator and baselines.

    Args:
        project: Folder with ``uv.lock`` and ``pyproject.toml``.

    Returns:
        By name, the requirement with version and hashes, as pip reads it.
    """
    export = ("export", "--quiet", "--offline", "--frozen", "--no-emit-project", "--no-header", "--no-annotate")
    uv = (sys.executable, "-m", "uv", *export, "--python", sys.executable, "--extra", "sim", "--extra", "cp")
    needed, developers = (_by_name(_output(*uv, *more, folder=project)) for more in (["--no-dev"], []))
    return needed | {"robosuite": developers["robosuite"]}  # not among our requirements: see docs/install.md


def choose(locked: Mapping[str, str], config: BundleConfig) -> dict[str, str]:
    """Chooses the packages that travel.

    Raises:
        ConfigError: A package that shall be left out is not among them.
    """
    for name in config.leave_out:
        if name not in locked:
            raise ConfigError(f"uv.lock does not name {name!r}, which shall be left out. {near_names(name, locked)}")
    unwanted = (*config.leave_out, *(() if config.with_torch else HEAVY))
    return {name: text for name, text in locked.items() if not any(fnmatch(name, pattern) for pattern in unwanted)}


def collect_wheels(requirements: Mapping[str, str], folder: Path) -> list[Path]:
    """Downloads wheels from where pip is used to, checks their hashes, and slims robosuite's."""
    folder.mkdir()
    listing = folder / "listing.txt"
    listing.write_text("\n".join(requirements.values()), encoding="utf-8")
    target = ("--only-binary=:all:", "--implementation=cp", "--python-version=3.12")
    platforms = (f"--platform={name}" for name in PLATFORMS)
    pip = (sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--require-hashes")
    _output(*pip, f"--requirement={listing}", f"--dest={folder}", *target, *platforms)
    listing.unlink()
    for full in list(folder.glob("robosuite-*.whl")):
        slim_wheel(full)
        full.unlink()
    return sorted(folder.glob("*.whl"))


def is_used(name: str) -> bool:
    """Tells whether the tasks need a file of robosuite's wheel; all code counts, it is small."""
    asset = name.removeprefix(ASSETS)
    return asset == name or any(fnmatch(asset, pattern) for pattern in USED_ASSETS)


def slim_wheel(full: Path) -> Path:
    """Writes robosuite's wheel without what no task uses, beside it.

    It keeps its version, which this package asks for, and says by its build tag that it is not the original.
    """
    name, version, _, _ = parse_wheel_filename(full.name)
    slim = full.with_name(f"{name}-{version}-1slim-py3-none-any.whl")
    info = f"{name}-{version}.dist-info"
    lines = []
    with ZipFile(full) as source, ZipFile(slim, "w") as target:
        for member in source.infolist():
            if member.filename == f"{info}/RECORD" or not is_used(member.filename):
                continue
            content = source.read(member)
            if member.filename == f"{info}/WHEEL":
                content = content.rstrip() + b"\nBuild: 1slim\n"
            target.writestr(member, content)
            digest = urlsafe_b64encode(sha256(content).digest()).rstrip(b"=").decode()
            lines.append(f"{member.filename},sha256={digest},{len(content)}\n")  # no name of it holds a comma
        record = source.getinfo(f"{info}/RECORD")
        target.writestr(record, "".join([*lines, f"{record.filename},,\n"]))
    return slim


def write_parts(folders: Mapping[str, Path], target: Path, size: int, time: int) -> None:
    """Writes files and folders as one tar archive, cut into ``part.0000`` and so on.

    Args:
        folders: What to write, by the name that it gets.
        target: Where the parts go.
        size: Bytes of a part.
        time: Time that all files get, so that equal content makes equal parts (seconds since 1970).

    Raises:
        StorageError: The disk is full, or cannot be written.
    """

    def anonymous(member: tarfile.TarInfo) -> tarfile.TarInfo:
        member.uid = member.gid = 0
        member.uname = member.gname = ""
        member.mtime = time
        return member

    try:
        with closing(_Parts(target, size)) as parts, tarfile.open(fileobj=parts, mode="w|", dereference=True) as tar:
            for name, path in folders.items():
                tar.add(path, name, filter=anonymous)
    except OSError as error:
        raise StorageError(f"The parts could not be written into {target} ({error}); make room on its disk.") from error


def write_sums(folder: Path) -> None:
    """Writes what ``sha256sum --check`` compares the folder's files with."""
    lines = [f"{sha256_of_file(path)}  {path.name}\n" for path in sorted(folder.iterdir())]
    (folder / "SHA256SUMS").write_text("".join(lines), encoding="utf-8")


class _Parts:
    """A file that goes on in the next one where it has reached its size."""

    def __init__(self, folder: Path, size: int) -> None:
        self._folder, self._size, self._number = folder, size, 0
        self._file = self._next()

    def write(self, block: bytes) -> int:
        written = 0
        while written < len(block):
            if self._file.tell() == self._size:
                self._file.close()
                self._file = self._next()
            written += self._file.write(block[written : written + self._size - self._file.tell()])
        return written

    def close(self) -> None:
        self._file.close()

    def _next(self) -> BinaryIO:
        self._number += 1
        return (self._folder / f"part.{self._number - 1:04}").open("wb")


def _recordings(folders: Sequence[Path]) -> dict[str, Path]:
    named = {f"recordings/{folder.resolve().name}": folder.resolve() for folder in folders}
    if missing := [str(folder) for folder in named.values() if not folder.is_dir()]:
        raise ConfigError(f"Recordings are folders; there is none at {', '.join(missing)}.")
    if len(named) < len(folders):
        raise ConfigError("Two recordings have the same name; rename one of their folders.")
    return named


def _by_name(exported: str) -> dict[str, str]:
    """Takes requirements apart, each of which begins at the margin and may go on in lines that do not."""
    blocks = re.split(r"\n(?=\S)", exported.strip())
    return {Requirement(block.partition("\\")[0]).name: block for block in blocks}


def _build(project: Path, folder: Path) -> Path:
    before = set(folder.iterdir())
    _output(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder), folder=project)
    (built,) = set(folder.iterdir()) - before
    return built


def _write_requirements(content: Path, wheels: Sequence[Path], locked: Mapping[str, str]) -> None:
    """Writes the versions that were packed; those that hang on the node's torch apart, with the torch they need."""
    versions = {str(name): str(version) for name, version, _, _ in (parse_wheel_filename(w.name) for w in wheels)}
    apart = {name: versions.pop(name) for name in COMPANIONS if locked and name in versions}
    if locked:
        (apart["torch"],) = (s.version for s in Requirement(locked["torch"].partition("\\")[0]).specifier)
    for file, named in (("requirements.txt", versions), ("companions.txt", apart)):
        lines = [f"{name}=={version}\n" for name, version in sorted(named.items())]
        (content / file).write_text("".join(lines), encoding="utf-8")


def _output(*command: str, folder: Path = PROJECT) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise BudsError(f"'{' '.join(command[:4])} ...' failed: {done.stderr.strip()[-2000:]}")
    return done.stdout


if __name__ == "__main__":
    config = parse(BundleConfig)
    run(lambda: bundle(config))
