"""Public names of a folder that load when they are asked for: settings must not wait for what the work needs."""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def on_demand(package: str) -> Callable[[str], Any]:
    """Makes the ``__getattr__`` (PEP 562) of a package that imports its public names under ``if TYPE_CHECKING`` alone.

    Those imports, which type checkers and import-linter read as ever, say from where a name comes: there is no second
    list. No name may be that of its folder's modules, which Python sets in its place.

    Args:
        package: Its ``__name__``.

    Returns:
        The function; what it has loaded it leaves in the package, so that a name is asked for once.
    """
    module = sys.modules[package]
    source = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
    (guarded,) = (node for node in source.body if isinstance(node, ast.If))
    imports = [node for node in guarded.body if isinstance(node, ast.ImportFrom)]
    homes = {alias.name: f".{node.module}" for node in imports for alias in node.names}

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(homes[name], package), name)
        setattr(module, name, value)
        return value

    return load
