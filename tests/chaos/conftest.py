"""How much chaos: all of it when this folder is what was asked for, a short form among all other tests."""

from __future__ import annotations

from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.fixture(scope="session")
def full(pytestconfig: pytest.Config) -> bool:
    """Whether `pytest tests/chaos` was typed, rather than all tests."""
    asked = [Path(pytestconfig.invocation_params.dir, argument.split("::")[0]) for argument in pytestconfig.args]
    return any(path.resolve() == HERE or HERE in path.resolve().parents for path in asked)
