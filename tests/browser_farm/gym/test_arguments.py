"""The arguments of the package's environment: all accepted, and checked before a browser starts."""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Any

import pytest
from miniwob.environment import MiniWoBEnvironment

from benchmarks.original_suite import ANSWERED_DIFFERENTLY, MODES
from browser_farm.gym.env import MiniWoB
from browser_farm.gym.vector_env import MiniWoBVector

ROOT = Path(__file__).parents[3]


def test_both_environments_have_every_argument_of_the_package() -> None:
    theirs = set(inspect.signature(MiniWoBEnvironment).parameters)
    assert theirs <= set(inspect.signature(MiniWoB).parameters)
    assert theirs - {"subdomain"} <= set(inspect.signature(MiniWoBVector).parameters)


@pytest.mark.parametrize(
    ("message", "arguments"),
    [
        ("task is None and subdomain None: wanted one of them", {}),
        ("wanted one of them", {"task": "click-test", "subdomain": "click-test"}),
        ("wait_ms is -1: wanted 0 or more", {"task": "click-test", "wait_ms": -1}),
        ("wait_ms is 10000: wanted 0 or more, and less than the 10000 ms", {"task": "click-test", "wait_ms": 10000}),
        (
            "base_url is 'pages/': wanted a folder's file:// or http:// URL",
            {"task": "click-test", "base_url": "pages/"},
        ),
        ("has no page of the task 'click-test'", {"task": "click-test", "base_url": "file:///nothing/"}),
    ],
)
def test_a_wrong_argument_is_one_clear_line_before_a_browser_starts(
    message: str, arguments: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("browser_farm.gym.launch.ChromeFarm", lambda **_: pytest.fail("started"))
    with pytest.raises(ValueError, match=message):
        MiniWoB(**arguments)


def test_the_original_suite_passes_in_real_time_and_the_document_lists_what_the_default_answers_differently() -> None:
    result = json.loads((ROOT / "benchmarks/results/original_suite.json").read_bytes())
    assert result["modes"].keys() == MODES.keys()
    default, real_time = result["modes"]["default"], result["modes"]["real_time"]
    assert real_time["passed"] == real_time["tests"] == default["tests"] == 51
    assert default["unexpected"] == real_time["unexpected"] == {}
    assert default["answered_differently"] == ANSWERED_DIFFERENTLY
    document = (ROOT / "docs/gymnasium.md").read_text()
    for test in ANSWERED_DIFFERENTLY:
        assert test.rpartition("::")[2] in document
    assert f"{default['passed']} of {default['tests']}" in document
