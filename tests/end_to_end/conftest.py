"""One run with several faults, shared by all tests that check how it survived them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.end_to_end.commands import run_folder
from tests.end_to_end.survival import Survival, survive


@pytest.fixture(scope="session")
def survival() -> Iterator[Survival]:
    """A `local` run with real Chrome whose browser, actor and reward service were killed one after the other."""
    with run_folder() as run:
        yield survive(run)
