"""Keeps text settings as they were typed: YAML reads a number in ``0012``, a truth in ``yes``, an error in ``*``.

Only text is quoted; everything else is left to draccus, whose syntax is YAML.
"""

import json
from collections.abc import Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from itertools import pairwise
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import yaml

from lerobot_buds.core import ConfigError

_FILE_OPTION = "--config_path"
_TEXT = (str, Path)


def keep_texts(settings: type[Any], arguments: Sequence[str]) -> list[str]:
    """Quotes the values of text settings, and the texts within lists and dictionaries of them.

    Args:
        settings: Dataclass of the settings.
        arguments: Command line, as ``--name=value`` or ``--name value``.

    Returns:
        The command line to parse. ``null`` still means None where a setting may be that, and ``include file`` a file.

    Raises:
        ConfigError: A list or a dictionary is not written as YAML.
    """
    kept: list[str] = []
    name = ""
    for argument in arguments:
        if argument.startswith("--"):
            name, equals, value = argument.partition("=")
            kept.append(name + equals + _quoted(settings, name, value) if equals else argument)
            name = "" if equals else name
        else:
            kept.append(_quoted(settings, name, argument) if name else argument)
            name = ""
    return kept


def require_texts(settings: type[Any], arguments: Sequence[str]) -> None:
    """Refuses a settings file in which YAML has read something else where text is meant.

    Args:
        settings: Dataclass of the settings.
        arguments: Command line, which may name a file by ``--config_path``.

    Raises:
        ConfigError: A text setting is a number, a date or a truth; names it and how to write it.
        OSError: The file cannot be read.
    """
    paths = [value for name, _, value in (a.partition("=") for a in arguments) if name == _FILE_OPTION and value]
    paths += [value for name, value in pairwise(arguments) if name == _FILE_OPTION]
    for path in map(Path, paths):
        if path.suffix in (".yaml", ".yml"):
            content = yaml.safe_load(path.read_text(encoding="utf-8"))
            _require_texts(settings, content if isinstance(content, dict) else {}, str(path))


def _require_texts(settings: type[Any], content: dict[Any, Any], where: str) -> None:
    for field in fields(settings):
        value = content.get(field.name)
        hint = get_type_hints(settings)[field.name]
        inner = _dataclass_of(field, hint)
        if inner is not None and isinstance(value, dict):
            _require_texts(inner, value, f"{where}, {field.name}")
        elif _is_text(hint) and not isinstance(value, str | NoneType):
            raise ConfigError(
                f'{where}: {field.name} is read as {value!r}, no text. Put it in quotes: {field.name}: "...".'
            )


def _quoted(settings: type[Any], name: str, value: str) -> str:
    hint = _hint(settings, name.removeprefix("--").split("."))
    if hint is None or value.startswith("include "):
        return value
    optional = NoneType in _alternatives(hint)
    if optional and value in ("null", "~"):
        return "null"
    if _is_text(hint):
        return json.dumps(value, ensure_ascii=False)
    texts = any(get_origin(kind) in (list, dict, tuple) and _all_text(kind) for kind in _alternatives(hint))
    if not texts:
        return value
    try:
        return json.dumps(yaml.load(value, yaml.BaseLoader), ensure_ascii=False)  # this loader knows texts alone
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"{name}={value} is not written as YAML has it: {reason}.") from error


def _hint(settings: type[Any], path: Sequence[str]) -> Any:
    """Finds the type of a setting by its dotted name; None where there is no such setting."""
    known = {field.name: field for field in fields(settings)}
    if path[0] not in known:
        return None
    hint = get_type_hints(settings)[path[0]]
    if len(path) == 1:
        return hint
    inner = _dataclass_of(known[path[0]], hint)
    return None if inner is None else _hint(inner, path[1:])


def _dataclass_of(field: "Field[Any]", hint: Any) -> type[Any] | None:
    """Tells the settings within a setting; of a choice, those of its default."""
    default = field.default_factory() if field.default_factory is not MISSING else field.default
    if is_dataclass(default) and not isinstance(default, type):
        return type(default)
    return next((kind for kind in _alternatives(hint) if isinstance(kind, type) and is_dataclass(kind)), None)


def _alternatives(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _is_text(hint: Any) -> bool:
    kinds = [kind for kind in _alternatives(hint) if kind is not NoneType]
    return all(kind in _TEXT for kind in kinds)


def _all_text(hint: Any) -> bool:
    return all(kind in _TEXT or kind is Ellipsis for kind in get_args(hint))
