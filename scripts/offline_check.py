"""Checks an installation without a network: versions, what the doctor checks, and a policy that acts.

    python scripts/offline_check.py chosen.txt

`scripts/offline_install.sh` runs it at its end.
"""

import logging
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

os.environ["HF_HUB_OFFLINE"] = "1"  # read when LeRobot is imported

import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies import make_policy, make_policy_config
from lerobot.utils.import_utils import register_third_party_plugins
from packaging.requirements import Requirement

from lerobot_buds.cli.doctor import Finding, examine, this_installation
from lerobot_buds.core import near_names

SMALL = {"encoder": "conv", "norm": "group", "conv_channels": [8, 8], "keypoints": 8, "head_widths": [32]}


def wrong_versions(requirements: list[str]) -> list[str]:
    """Names the requirements that what Python finds does not meet: a node's own packages may come in the way."""
    wrong = []
    for requirement in map(Requirement, requirements):
        try:
            found = version(requirement.name)
        except PackageNotFoundError:
            found = None
        if found is None or not requirement.specifier.contains(found, prereleases=True):
            wrong.append(f"{requirement.name} {found or 'is missing'} (needs {requirement.specifier})")
    return wrong


def check_versions(listing: Path) -> Finding:
    """Compares the versions with those packed, and the node's torch with those that LeRobot works with."""
    packed = listing.read_text(encoding="utf-8").split()
    of_lerobot = [r for r in requires("lerobot") or () if Requirement(r).name in ("torch", "torchvision")]
    if wrong := wrong_versions([*packed, *of_lerobot]):
        return Finding("packages", "FAIL", ", ".join(wrong), "take them away from Python's path, or use another Python")
    return Finding("packages", "ok", f"{len(packed)} as they were packed")


def check_doctor() -> Iterator[Finding]:
    """Asks the doctor about the packages that Python takes: where the node has one too, both are to be seen."""
    installation = this_installation()
    return examine(replace(installation, versions={name: version(name) for name in installation.versions}))


def check_policy() -> Finding:
    """Lets a tiny policy act that LeRobot finds by its name, on the GPU where there is one.

    Raises:
        Exception: Whatever stops it.
    """
    register_third_party_plugins()
    known = PreTrainedConfig.get_known_choices()
    if "buds" not in known:
        return Finding("policy", "FAIL", f"LeRobot does not find 'buds'. {near_names('buds', known)}", "see above")
    from lerobot_buds.envs.configuration_robosuite import RobosuiteEnvConfig

    logging.disable(logging.WARNING)  # that it is untrained
    device = "cuda" if torch.cuda.is_available() else "cpu"
    policy = make_policy(make_policy_config("buds", device=device, **SMALL), env_cfg=RobosuiteEnvConfig(image_size=64))
    observation = {key: torch.rand(2, *f.shape, device=device) for key, f in policy.config.input_features.items()}
    action = policy.select_action({**observation, "task": ["", ""]})
    place = torch.cuda.get_device_name() if device == "cuda" else "the CPU: torch sees no GPU"
    if action.shape != (2, 4) or not action.isfinite().all():
        return Finding("policy", "FAIL", f"acts with {action} on {place}", "another version of torch")
    return Finding("policy", "ok", f"'buds' acts with torch {torch.__version__} on {place}")


def findings(listing: Path) -> Iterator[Finding]:
    """Runs all checks."""
    yield check_versions(listing)
    yield from check_doctor()
    yield check_policy()


def main() -> None:
    """Prints one line per check as it finishes, and exits with status 1 where any failed."""
    failed = False
    for finding in findings(Path(sys.argv[1])):
        print(finding, flush=True)
        failed |= finding.status == "FAIL"
    sys.exit(failed)


if __name__ == "__main__":
    main()
