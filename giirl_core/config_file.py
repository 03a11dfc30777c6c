"""The tree of settings read from TOML or from an earlier run, overridden by key=value, written as JSON."""

from __future__ import annotations

import dataclasses
import difflib
import json
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from giirl_core.config import Config
from giirl_core.renamed_settings import RENAMED

_TREE = TypeAdapter(Config)


def load_config(path: Path | None, overrides: Sequence[str] = ()) -> Config:
    """The tree in `path` (TOML, or the JSON of an earlier run), changed by `key.sub=value` overrides.

    Raises ValueError, one line, for a file that cannot be read, a key that does not exist or a value that is
    not allowed.
    """
    tree = _read(path) if path is not None else {}
    where = str(path) if path is not None else "the command line"
    defaults = dict(_leaves(_TREE.dump_python(Config(), mode="json")))
    for override in overrides:
        key, equals, text = override.partition("=")
        if not equals or not key:
            raise ValueError(f"{override!r} is not an override: wanted key=value, for example seed=1")
        _set(tree, key, _value(text, defaults.get(key)))
    if isinstance(tree.get("tasks"), list):
        tree["tasks"] = [name for entry in tree["tasks"] for name in _task_files(entry)]
    return parse_config(tree, where)


def _task_files(entry: Any) -> list[Any]:
    """The task files of a folder, "tasks/"; any other entry is a task itself."""
    if not (isinstance(entry, str) and entry.endswith("/")):
        return [entry]
    files = sorted(str(path) for path in Path(entry).glob("*.toml"))
    if not files:
        raise ValueError(f"tasks has the folder {entry!r}, which has no task file: wanted NAME.toml in it")
    return files


def parse_config(tree: dict[str, Any], where: str) -> Config:
    """Validate a tree; `where` names it in errors."""
    try:
        return _TREE.validate_python(tree)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        if first["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
            if key in RENAMED:
                raise ValueError(f"{where}: the setting {key!r} is now {RENAMED[key]!r}") from None
            near = difflib.get_close_matches(key, keys(), n=1, cutoff=0.0)
            raise ValueError(f"{where}: there is no setting {key!r}; the nearest is {near[0]!r}") from None
        raise ValueError(f"{where}: {key} = {first['input']!r}: {first['msg']}") from None


def dump_config(config: Config) -> str:
    """The whole tree as JSON, in a form that `load_config` reads back."""
    return _TREE.dump_json(config, indent=2).decode() + "\n"


def changed(config: Config) -> list[str]:
    """key=value for every setting that is not its default."""
    values = dict(_leaves(_TREE.dump_python(config, mode="json")))
    return [f"{key}={values[key]}" for key in differences(Config(), config)]


def differences(config: Config, other: Config) -> list[str]:
    """The settings whose values differ, by their dotted names."""
    values = dict(_leaves(_TREE.dump_python(config, mode="json")))
    return [key for key, value in _leaves(_TREE.dump_python(other, mode="json")) if value != values[key]]


def _leaves(tree: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def keys(section: type[Any] = Config, prefix: str = "") -> list[str]:
    """Every setting by its dotted name."""
    found = []
    for field in dataclasses.fields(section):
        found.append(prefix + field.name)
        if dataclasses.is_dataclass(field.default):
            found += keys(type(field.default), f"{prefix}{field.name}.")
    return found


def _read(path: Path) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8-sig")  # in any locale, and with the mark that Windows puts first
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"cannot read the config {path}: {error}; settings are given as key=value") from None
    try:
        tree = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except ValueError as error:
        raise ValueError(f"{path} is not valid {path.suffix[1:].upper() or 'TOML'}: {error}") from None
    if not isinstance(tree, dict):
        raise ValueError(f"{path} holds {type(tree).__name__}, wanted a table of settings")
    return tree


def _value(text: str, default: Any) -> Any:
    """A TOML value, or the text itself where it is none or a text is wanted: `run=out/a` needs no quotes."""
    if isinstance(default, str) and not text.startswith(('"', "'")):
        return text
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _set(tree: dict[str, Any], key: str, value: Any) -> None:
    *path, last = key.split(".")
    for part in path:
        tree = tree.setdefault(part, {})
        if not isinstance(tree, dict):
            raise ValueError(f"there is no setting {key!r}: {part!r} is a value, not a section")
    tree[last] = value
