"""The generated reference of settings: complete, and the same as the committed page."""

from __future__ import annotations

from pathlib import Path

from pydantic import TypeAdapter

from giirl_core.config import Config
from giirl_core.config_file import keys
from giirl_core.config_reference import reference

PAGE = Path(__file__).parents[2] / "docs/configuration.md"


def test_the_committed_reference_is_the_generated_one() -> None:
    assert PAGE.read_text() == reference(), (
        "write it again: python -m giirl_core.config_reference > docs/configuration.md"
    )


def test_every_setting_has_a_description() -> None:
    schema = TypeAdapter(Config).json_schema()
    sections = [schema, *schema["$defs"].values()]
    settings = {key: value for section in sections for key, value in section["properties"].items()}
    assert [key for key, value in settings.items() if "$ref" not in value and not value.get("description")] == []


def test_the_reference_lists_every_setting_by_its_dotted_name() -> None:
    page, sections = reference(), {key.rpartition(".")[0] for key in keys()}
    assert [key for key in keys() if key not in sections and f"**`{key}`**" not in page] == []
