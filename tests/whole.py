"""Whether a folder is tested by itself, and so in full, or together with other tests."""

from __future__ import annotations

from pathlib import Path

import pytest


def is_tested_alone(folder: Path, pytestconfig: pytest.Config) -> bool:
    """Whether pytest was started with `folder` or with something in it."""
    paths = [Path(pytestconfig.invocation_params.dir, argument.split("::")[0]) for argument in pytestconfig.args]
    return any(path.resolve() == folder or folder in path.resolve().parents for path in paths)
