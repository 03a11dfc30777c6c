"""How long the chaos tests run: fully if only this folder is tested, in a short form together with other tests."""

from __future__ import annotations

from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.fixture(scope="session")
def full(pytestconfig: pytest.Config) -> bool:
    """Whether pytest was started for this folder (`pytest tests/chaos`) rather than for all tests."""
    paths = [Path(pytestconfig.invocation_params.dir, argument.split("::")[0]) for argument in pytestconfig.args]
    return any(path.resolve() == HERE or HERE in path.resolve().parents for path in paths)
