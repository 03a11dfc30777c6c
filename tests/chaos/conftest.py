"""How long the chaos tests run: fully if only this folder is tested, in a short form together with other tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.whole import is_tested_alone


@pytest.fixture(scope="session")
def full(pytestconfig: pytest.Config) -> bool:
    """Whether pytest was started for this folder (`pytest tests/chaos`) rather than for all tests."""
    return is_tested_alone(Path(__file__).parent, pytestconfig)
