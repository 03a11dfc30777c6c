"""What holds for every test before a library loads: one thread each, nothing reported, home untouched."""

from __future__ import annotations

import os
import secrets
import signal
import socketserver

from hypothesis import settings

# Two cores carry Chrome, Ray and torch at once: more threads a process only wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Selenium must neither fetch a driver nor report that it ran.
os.environ.setdefault("SE_OFFLINE", "true")
os.environ.setdefault("SE_AVOID_STATS", "true")

# Ray would write a token into the home directory; one in the environment ends with the tests.
os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")

# A shell starts what goes to the background deaf to Ctrl-C, and its children inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# A server of metrics looks every half second whether it shall stop; tests start and stop many.
socketserver.BaseServer.serve_forever.__defaults__ = (0.01,)

# No test may fail because the machine is busy; where a failure must repeat, the examples must too.
settings.register_profile("giirl", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("giirl")
