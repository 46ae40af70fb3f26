"""``lerobot-buds-doctor``: checks the installation and names one remedy for everything it finds wrong.

LeRobot logs and then ignores a plugin that cannot be imported; what its user sees is only "invalid choice: 'buds'".
Here the plugin is imported last and nothing is swallowed: a fault inside it ends in its own traceback.
"""

import shlex
import shutil
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module, metadata
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from lerobot_buds.core import LEROBOT_REMEDY, ConfigError, SimulatorError, untried_lerobot
from lerobot_buds.envs import EnvSettings, RobosuiteEnv
from lerobot_buds.envs.loading import ROBOSUITE_VERSION
from lerobot_buds.envs.remedies import CannotStartError, backend

if TYPE_CHECKING:
    from lerobot_buds.data import FrameStore

from .running import parse

DISTRIBUTION = "lerobot_policy_buds"
"""The installed name, and the module that LeRobot imports because of it; a dashed name would not be discovered."""

ROBOSUITE = f"robosuite=={ROBOSUITE_VERSION}"
"""Not among the distribution's requirements, since it has to be installed without its own (see docs/install.md)."""

_IN_A_CHECKOUT = "in a checkout of this package: make setup, or {} (by its name once it is published)"

_TASK = "hammer_place"  # any will do
_LIMIT = "BUDS_STORE_LIMIT"

LOW_DISK, NO_DISK = 10 * 2**30, 2**30
"""Free bytes under which a warning is given, and under which a run cannot be expected to finish (ours)."""


@dataclass(frozen=True)
class Finding:
    """What one check found.

    Attributes:
        name: What was checked.
        status: "FAIL" where something will not work, "warning" where it works less well.
        detail: What was found.
        remedy: What to do about it; empty where all is well.
    """

    name: str
    status: Literal["ok", "warning", "FAIL"]
    detail: str
    remedy: str = ""

    def __str__(self) -> str:
        """Formats the finding as one line."""
        detail = " ".join(self.detail.split())
        return f"{self.status:<8} {self.name:<10} {detail}" + (f" -> {self.remedy}" if self.remedy else "")


@dataclass(frozen=True)
class Installation:
    """What the checks look at, so that a test can make up a broken one.

    Attributes:
        plugins: Names of the installed distributions, spelled as their metadata spell them: what LeRobot searches.
        requirements: What this package requires, markers included.
        versions: Installed version by canonical distribution name.
        opencv_owners: Names of the distributions that own the module ``cv2``.
        free_bytes: Free disk space of the working folder (bytes).
        load: Imports a module by name.
        registered: Lists the policy types and the environment types that LeRobot knows; called once the plugin is
            imported.
        render: Resets a task and draws one ``(H, W, 3)`` uint8 frame of it.
        store: Opens the store of decoded frames.
    """

    plugins: Collection[str]
    requirements: Sequence[str]
    versions: Mapping[str, str]
    opencv_owners: Collection[str]
    free_bytes: int
    load: Callable[[str], object]
    registered: Callable[[], tuple[Collection[str], Collection[str]]]
    render: Callable[[], NDArray[np.uint8]]
    store: Callable[[], "FrameStore"]


def check_discovery(installation: Installation) -> Finding:
    """Is the distribution installed under the name that LeRobot looks for?"""
    if DISTRIBUTION in installation.plugins:
        return Finding("discovery", "ok", f"{DISTRIBUTION} is installed under the name that LeRobot looks for")
    near = [name for name in installation.plugins if canonicalize_name(name) == canonicalize_name(DISTRIBUTION)]
    detail = f"it is installed as {near[0]}, which LeRobot skips" if near else f"{DISTRIBUTION} is not installed"
    return Finding("discovery", "FAIL", detail, _IN_A_CHECKOUT.format("pip install ."))


def check_lerobot(installation: Installation) -> Finding:
    """Is LeRobot one of those that this package was tried with?"""
    version = installation.versions.get("lerobot")
    if version is None:
        return Finding("LeRobot", "FAIL", "not installed", LEROBOT_REMEDY)
    untried = untried_lerobot(version)
    if untried is None:
        return Finding("LeRobot", "ok", f"{version} is one that was tried")
    return Finding("LeRobot", "warning", f"{untried}; it may work", LEROBOT_REMEDY)


def check_versions(installation: Installation) -> Finding:
    """Are the other required packages there, in versions that this package works with?"""
    wanted = [r for r in installation.requirements if _needed(r) and Requirement(r).name != "lerobot"]
    return _compare("versions", wanted, installation.versions)


def check_simulator(installation: Installation) -> Finding:
    """Are robosuite and what it needs there, in versions that work together? A machine for training needs neither."""
    if "robosuite" not in installation.versions:
        remedy = f"pip install '{DISTRIBUTION}[sim]' && pip install --no-deps {ROBOSUITE}"
        return Finding("simulator", "warning", "not installed: training works, environments do not", remedy)
    wanted = [r for r in installation.requirements if _needed(r, "sim") and not _needed(r)]
    return _compare("simulator", [ROBOSUITE, *wanted], installation.versions)


def check_rendering(installation: Installation) -> Finding:
    """Can a task be reset and drawn without a display, in the way that every command does it?"""
    if not {"mujoco", "robosuite"} <= set(installation.versions):
        return Finding("rendering", "ok", "not tried: the simulator is not installed")
    try:
        frame = installation.render()
    except CannotStartError as error:
        return Finding("rendering", "FAIL", error.cause, error.remedy)
    except SimulatorError as error:
        return Finding("rendering", "FAIL", str(error), "see docs/install.md")
    if not frame.any():
        return Finding("rendering", "FAIL", f"nothing but black, with MUJOCO_GL={backend()}", "see docs/install.md")
    height, width = frame.shape[:2]
    return Finding("rendering", "ok", f"drew {height}x{width} pixels with MUJOCO_GL={backend()}")


def check_decoder(installation: Installation) -> Finding:
    """Which video decoder will LeRobot use?"""
    failures = []
    for module, name in (("torchcodec.decoders", "torchcodec"), ("av", "pyav")):
        try:
            installation.load(module)
        except (ImportError, OSError, RuntimeError) as error:
            failures.append(f"{name} does not load ({str(error).partition('\n')[0].partition('. ')[0]})")
            continue
        if not failures:
            return Finding("decoder", "ok", name)
        detail = f"{failures[0]}; LeRobot falls back to {name}: about half the speed, no streaming"
        return Finding("decoder", "warning", detail, "apt-get install ffmpeg")
    return Finding("decoder", "FAIL", "; ".join(failures), "pip install --force-reinstall av, apt-get install ffmpeg")


def check_opencv(installation: Installation) -> Finding:
    """Does exactly one distribution own the module ``cv2``, and is it the one that needs no display?"""
    owners = sorted({canonicalize_name(name) for name in installation.opencv_owners})
    if owners == ["opencv-python-headless"]:
        return Finding("OpenCV", "ok", f"{owners[0]} alone")
    reinstall = "pip install --no-deps --force-reinstall 'opencv-python-headless<4.14'"
    if not owners:
        return Finding("OpenCV", "FAIL", "no distribution provides cv2", reinstall)
    detail = f"{' and '.join(owners)} own cv2; whichever was installed last is used, and LeRobot needs the headless one"
    others = " ".join(name for name in owners if name != "opencv-python-headless")
    return Finding("OpenCV", "FAIL", detail, f"pip uninstall -y {others} && {reinstall}")


def check_disk(installation: Installation) -> Finding:
    """Is there room for datasets, frame caches and checkpoints?"""
    detail = f"{installation.free_bytes / 2**30:.1f} GiB free in the working folder"
    if installation.free_bytes >= LOW_DISK:
        return Finding("disk", "ok", detail)
    status: Literal["warning", "FAIL"] = "FAIL" if installation.free_bytes < NO_DISK else "warning"
    return Finding("disk", status, detail, f"free {LOW_DISK // 2**30} GiB, or work on another disk")


def check_store(installation: Installation) -> Finding:
    """Where do decoded frames lie, how much of its bound do they take, and how is the folder emptied?"""
    try:
        store = installation.store()
    except ImportError as error:  # what is missing is among the versions
        return Finding("frames", "ok", f"not looked at: LeRobot cannot be imported ({error})")
    except ConfigError as error:
        return Finding("frames", "FAIL", str(error), f"unset {_LIMIT}")
    used, limit = store.used_bytes(), store.limit_bytes
    detail = f"{used / 2**30:.1f} of at most {limit / 2**30:.1f} GiB decoded frames in {store.folder}"
    detail += f" (bound: {_LIMIT}; to empty it: rm -r {shlex.quote(str(store.folder))})"
    if used <= limit:
        return Finding("frames", "ok", detail)
    return Finding("frames", "warning", detail, f"raise {_LIMIT}, or empty the folder")


def check_plugin(installation: Installation) -> Finding:
    """Does the plugin import, and does LeRobot know its policy and its environment afterwards?

    Raises:
        Exception: Whatever the import raises, unless a module is missing.
    """
    try:
        installation.load(DISTRIBUTION)
    except ImportError as error:
        remedy = _IN_A_CHECKOUT.format("pip install .")
        return Finding("plugin", "FAIL", f"{DISTRIBUTION} cannot be imported: {error}", remedy)
    policies, environments = installation.registered()
    missing = ["policy 'buds'"] * ("buds" not in policies) + ["environment 'robosuite'"] * (
        "robosuite" not in environments
    )
    if missing:
        detail = f"imported, but LeRobot does not know {' and '.join(missing)}: the installed files are not whole"
        remedy = _IN_A_CHECKOUT.format("pip install --force-reinstall --no-deps .")
        return Finding("plugin", "FAIL", detail, remedy)
    return Finding("plugin", "ok", "LeRobot knows policy 'buds' and environment 'robosuite'")


CHECKS = (
    check_discovery,
    check_lerobot,
    check_versions,
    check_simulator,
    check_rendering,
    check_decoder,
    check_opencv,
    check_disk,
    check_store,
    check_plugin,  # last: a fault inside the plugin raises, and by then everything else is reported
)


def examine(installation: Installation) -> Iterator[Finding]:
    """Runs all checks, in the order of `CHECKS`."""
    return (check(installation) for check in CHECKS)


def this_installation() -> Installation:
    """Describes the interpreter that runs this, without importing the plugin yet."""
    # Of a package that lies on the path twice, the first is imported.
    found = {d.metadata["Name"]: d.version for d in reversed(list(metadata.distributions()))}
    return Installation(
        plugins=list(found),
        requirements=metadata.requires(DISTRIBUTION) or () if DISTRIBUTION in found else (),
        versions={str(canonicalize_name(name)): version for name, version in found.items()},
        opencv_owners=metadata.packages_distributions().get("cv2", ()),
        free_bytes=shutil.disk_usage(Path.cwd()).free,
        load=import_module,
        registered=_registered,
        render=_render,
        store=_store,
    )


@dataclass
class DoctorConfig:
    """Checks this installation of lerobot_buds; takes no options."""


def main() -> None:
    """Prints one line per check as it finishes, and exits with status 1 where any failed."""
    parse(DoctorConfig)
    failed = False
    for finding in examine(this_installation()):
        print(finding, flush=True)
        failed |= finding.status == "FAIL"
    sys.exit(failed)


def _needed(requirement: str, extra: str = "") -> bool:
    marker = Requirement(requirement).marker
    return marker is None or marker.evaluate({"extra": extra})


def _compare(name: str, wanted: Sequence[str], versions: Mapping[str, str]) -> Finding:
    found, wrong, remedies = [], [], []
    for requirement in map(Requirement, wanted):
        version = versions.get(canonicalize_name(requirement.name))
        found.append(f"{requirement.name} {version}")
        if version is None or not requirement.specifier.contains(version, prereleases=True):
            requirement.marker = None
            wrong.append(f"{requirement.name} {version or 'is missing'} (needs {requirement.specifier})")
            no_deps = "--no-deps " if str(requirement) == ROBOSUITE else ""
            remedies.append(f"pip install {no_deps}'{requirement}'")
    if wrong:
        return Finding(name, "FAIL", ", ".join(wrong), " && ".join(remedies))
    return Finding(name, "ok", ", ".join(found))


def _registered() -> tuple[Collection[str], Collection[str]]:
    from lerobot.configs import PreTrainedConfig
    from lerobot.envs import EnvConfig

    return list(PreTrainedConfig.get_known_choices()), list(EnvConfig.get_known_choices())


def _store() -> "FrameStore":
    from lerobot_buds.data import FrameStore  # imports LeRobot

    return FrameStore.open()


def _render() -> NDArray[np.uint8]:
    env = RobosuiteEnv(EnvSettings(_TASK, image_size=64))
    try:
        frame: NDArray[np.uint8] = env.reset(seed=0)[0]["pixels"]["agentview"]
    finally:
        env.close()
    return frame
