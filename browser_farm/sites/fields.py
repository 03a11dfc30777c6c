"""Fields of an instruction: the values that they are drawn from, and templates in which they stand."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

PLACE = re.compile(r"\{(\w+)\}")
REFERENCE = re.compile(r"\{(env:)?(\w+)\}")  # to a field, or to a variable of the environment
NAME = re.compile(r"[A-Za-z]\w*")
DRAWN = ("seed", "episode")  # placeholders of every task: the page's seed, and an id that no other episode has
MAX_RANGE = 1_000_000


@dataclass(frozen=True, slots=True)
class Fields:
    """Groups of fields that are drawn together: the columns of one CSV file are one group, so they fit each other."""

    groups: tuple[tuple[Mapping[str, str], ...], ...]  # for each group its possible values, one mapping for each

    @property
    def names(self) -> tuple[str, ...]:
        """Every field."""
        return tuple(name for group in self.groups for name in group[0])

    def draw(self, rng: np.random.Generator) -> dict[str, str]:
        """A value for each field."""
        values: dict[str, str] = {}
        for group in self.groups:
            values |= group[int(rng.integers(len(group)))]
        return values


def read_fields(table: Mapping[str, Any], folder: Path) -> Fields:
    """The fields of a task file. CSV files lie relative to `folder`. ValueError for a field without values."""
    groups: list[tuple[Mapping[str, str], ...]] = []
    columns: dict[str, dict[str, str]] = {}  # CSV file -> field -> column
    for name, source in table.items():
        if not NAME.fullmatch(name) or name in DRAWN:
            raise ValueError(
                f"fields.{name} is no name for a field: wanted letters and digits, not {' or '.join(DRAWN)}"
            )
        if isinstance(source, Mapping) and set(source) == {"csv", "column"}:
            columns.setdefault(str(source["csv"]), {})[name] = str(source["column"])
        else:
            groups.append(tuple({name: value} for value in _values(name, source)))
    groups += [_read_csv(folder / file, own) for file, own in columns.items()]
    return Fields(tuple(groups))


def _values(name: str, source: Any) -> Sequence[str]:
    if isinstance(source, Mapping) and {"from", "to"} <= set(source) <= {"from", "to", "step"}:
        numbers = (source["from"], source["to"], source.get("step", 1))
        if not all(isinstance(number, int) for number in numbers) or numbers[2] < 1:
            raise ValueError(f"fields.{name} is {dict(source)}: wanted whole numbers, and a step of at least 1")
        values = [str(number) for number in range(numbers[0], numbers[1] + 1, numbers[2])[:MAX_RANGE]]
    elif isinstance(source, list) and all(isinstance(value, str | int | float) for value in source):
        values = [str(value) for value in source]
    else:
        raise ValueError(
            f"fields.{name} is {source!r}: wanted a list, {{from = 1, to = 9}} or {{csv = 'file.csv', column = 'name'}}"
        )
    if not values:
        raise ValueError(f"fields.{name} has no values")
    return values


def _read_csv(path: Path, columns: Mapping[str, str]) -> tuple[Mapping[str, str], ...]:
    """For each row the values of these fields, which are columns of the file."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            header = reader.fieldnames or []
            for name, column in columns.items():
                if column not in header:
                    raise ValueError(f"fields.{name}: {path} has no column {column!r}, it has {', '.join(header)}")
            rows = tuple({name: row[column] or "" for name, column in columns.items()} for row in reader)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"fields.{next(iter(columns))}: cannot read {path}: {error}") from None
    if not rows:
        raise ValueError(f"fields.{next(iter(columns))}: {path} has no rows")
    return rows


def check_template(where: str, template: str, known: set[str]) -> None:
    """ValueError if a template has a place that no field fills."""
    for name in PLACE.findall(template):
        if name not in known:
            fields = ", ".join(sorted(known - set(DRAWN))) or "none"
            raise ValueError(f"{where} has {{{name}}}, which is no field: the fields are {fields}")


def fill(template: str, values: Mapping[str, str], quote: Callable[[str], str] = str) -> str:
    """The template with the values, each as `quote` writes it. Places that no value fills stay as they are."""
    return PLACE.sub(lambda m: quote(values[m[1]]) if m[1] in values else m[0], template)


def resolve(text: str, values: Mapping[str, str]) -> str:
    """What a reference stands for: {field} for its value, {env:NAME} for a variable of the environment.

    Other text stands for itself. ValueError for a variable that is not set.
    """
    reference = REFERENCE.fullmatch(text)
    if reference is None:
        return text
    source = os.environ if reference[1] else values
    if reference[1] and reference[2] not in source:
        raise ValueError(f"the environment has no {reference[2]}, which a demonstration refers to as {text}")
    return source.get(reference[2], text)
