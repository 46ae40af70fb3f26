"""Which releases of LeRobot this package was tried with, and what is said of others."""

from packaging.specifiers import SpecifierSet

LEROBOT_RANGE = ">=0.6.1,<0.7"
"""The same as in pyproject.toml. 0.6.1 is what all tests run with; of 0.6.2 the development version of 2026-08-23 was
tried (docs/install.md)."""

LEROBOT_REMEDY = "pip install 'lerobot[training]==0.6.1'"


def untried_lerobot(version: str) -> str | None:
    """Says in a sentence that a LeRobot is none of those that this package was tried with; None where it is one."""
    if SpecifierSet(LEROBOT_RANGE).contains(version, prereleases=True):
        return None
    return f"LeRobot {version} is not among those that lerobot_policy_buds was tried with ({LEROBOT_RANGE})"
