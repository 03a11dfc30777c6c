"""Fixtures: one farm per test module, because starting Chrome takes longer than most tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.browser_farm.real_farm import Farm


@pytest.fixture(scope="module")
def shared() -> Iterator[Farm]:
    farm = Farm()
    yield farm
    farm.chrome.close()


@pytest.fixture
def farm(shared: Farm) -> Farm:
    shared.causes.clear()
    return shared
