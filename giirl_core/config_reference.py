"""Prints the reference of all settings as Markdown.

`python -m giirl_core.config_reference > docs/configuration.md` updates the committed page.
"""

from __future__ import annotations

import json
import re
import sys
import textwrap
from typing import Any

from pydantic import TypeAdapter

from giirl_core.config import Config

HEAD = """\
# Configuration

Every setting, its default and its meaning. This page is generated from `giirl_core/config/`.
After a change of a setting, write it again:

    .venv/bin/python -m giirl_core.config_reference > docs/configuration.md

A config is a TOML file. Every setting can also be given on the command line as `key=value`, which overrides the file:

    giirl train experiments/miniwob_four.toml seed=1 policy.entropy=0.2 tasks='["click-button"]'

A key that does not exist is an error that names the nearest key. The run's folder keeps all settings in `config.json`,
defaults included; `giirl train FOLDER/config.json run=NEW` repeats the run. `giirl train --resume RUN` accepts changes
of `iterations`, `checkpoint_every`, `keep_checkpoints`, `evaluate` and `metrics` only.

Each entry reads `key` = default (allowed values; unit), then the meaning.
"""
LINE = 120  # columns
UNIT = re.compile(r"\s*\[([^\]]+)\]$")
TYPES = {"string": "text", "boolean": "true or false", "integer": "integer", "number": "number", "array": "list"}
LIMITS = {
    "minimum": "from",
    "exclusiveMinimum": "above",
    "maximum": "to",
    "exclusiveMaximum": "below",
    "multipleOf": "a multiple of",
    "minItems": "length from",
}

Schema = dict[str, Any]


def reference() -> str:
    """The whole page, as Markdown."""
    schema = TypeAdapter(Config).json_schema()
    sections = {key: _section(schema, value) for key, value in schema["properties"].items() if "$ref" in value}
    parts = [HEAD, _contents(sections), "## Top level\n", _entries(schema, "")]
    for key, section in sections.items():
        parts += [f"## `{key}`\n", _filled(section["description"]), _entries(section, f"{key}.")]
    return "\n".join(parts)


def _section(schema: Schema, value: Schema) -> Schema:
    section: Schema = schema["$defs"][value["$ref"].rpartition("/")[2]]
    return section


def _contents(sections: dict[str, Schema]) -> str:
    """A table of the sections with the first sentence of each."""
    rows = [f"| [`{key}`](#{key}) | {section['description'].splitlines()[0]} |" for key, section in sections.items()]
    return "\n".join(["| section | what it is about |", "|-|-|", *rows]) + "\n"


def _entries(section: Schema, prefix: str) -> str:
    """A list with one entry for each setting of a section."""
    settings = {key: value for key, value in section["properties"].items() if "$ref" not in value}
    return "".join(_entry(prefix + key, value) for key, value in settings.items())


def _entry(key: str, value: Schema) -> str:
    found = UNIT.search(value["description"])
    meaning, unit = UNIT.sub("", value["description"]), f"; {found.group(1)}" if found else ""
    text = f"- **`{key}`** = `{json.dumps(value['default'])}` ({_range(value)}{unit}). {meaning}"
    return textwrap.fill(" ".join(text.split()), LINE, subsequent_indent="  ", break_on_hyphens=False) + "\n"


def _range(value: Schema) -> str:
    """The values that a setting may have, in words."""
    if "enum" in value:
        return "one of " + ", ".join(json.dumps(choice) for choice in value["enum"])
    limits = [f"{words} {value[name]:g}" for name, words in LIMITS.items() if name in value]
    return ", ".join([TYPES[value["type"]], *limits])


def _filled(text: str) -> str:
    """Paragraphs of a docstring, wrapped."""
    paragraphs = [" ".join(part.split()) for part in text.split("\n\n")]
    return "\n\n".join(textwrap.fill(part, LINE, break_on_hyphens=False) for part in paragraphs) + "\n"


if __name__ == "__main__":
    sys.stdout.write(reference())
