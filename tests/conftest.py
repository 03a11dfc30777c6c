"""Settings that must be in place before libraries load: one thread each, no telemetry, home folder untouched."""

from __future__ import annotations

import os
import secrets
import signal
import socketserver
from pathlib import Path

import pytest
from hypothesis import settings

# Chrome, Ray and torch share two cores: with more threads per process they only wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Selenium must not download a driver or send usage statistics.
os.environ.setdefault("SE_OFFLINE", "true")
os.environ.setdefault("SE_AVOID_STATS", "true")

# Without a token in the environment Ray would write one into the home folder.
os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")

# A process that a shell starts in the background ignores SIGINT, and its children inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Metrics servers check twice a second whether to stop; tests start and stop many of them.
socketserver.BaseServer.serve_forever.__defaults__ = (0.01,)

# A slow machine must not fail a test. In CI, examples are the same in every run, so that failures can be reproduced.
settings.register_profile("giirl", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("giirl")


@pytest.fixture(scope="module")
def full(request: pytest.FixtureRequest) -> bool:
    """Whether pytest was started for the folder of this test, or for something in it, rather than for all tests.

    Tests that take many minutes run in full then, otherwise in a short form.
    """
    folder, config = request.path.parent, request.config
    paths = [Path(config.invocation_params.dir, argument.split("::")[0]).resolve() for argument in config.args]
    return any(path == folder or folder in path.parents for path in paths)
