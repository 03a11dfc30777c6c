"""One farm for the tests of a module: starting Chrome takes longer than most of them."""

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
