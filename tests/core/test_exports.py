"""Names that load on demand are those that type checkers see."""

import importlib
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "lerobot_buds"
ON_DEMAND = [path.parent.name for path in PACKAGE.glob("*/__init__.py") if "on_demand(__name__)" in path.read_text()]


@pytest.mark.parametrize("name", ON_DEMAND)
def test_every_public_name_is_there(name: str) -> None:
    package = importlib.import_module(f"lerobot_buds.{name}")
    for public in package.__all__:
        assert getattr(package, public) is vars(package)[public]
        assert not (PACKAGE / name / f"{public}.py").exists()  # the module would be found in its place


@pytest.mark.parametrize("name", ON_DEMAND)
def test_other_names_are_not(name: str) -> None:
    package = importlib.import_module(f"lerobot_buds.{name}")
    with pytest.raises(AttributeError, match=f"module 'lerobot_buds.{name}' has no attribute 'absent'"):
        _ = package.absent
    with pytest.raises(ImportError, match="cannot import name 'absent'"):
        exec(f"from lerobot_buds.{name} import absent")


def test_there_are_some() -> None:
    assert {"representation", "segmentation"} <= set(ON_DEMAND)
