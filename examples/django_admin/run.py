"""Serves the shop, trains on its five tasks and evaluates.

python examples/django_admin/run.py [options and settings of `giirl train`]
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
STOP_TIMEOUT_S = 10.0


def main() -> int:
    """The exit status of the training."""
    with subprocess.Popen([sys.executable, HERE / "serve.py"], stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        try:
            if not server.stdout.readline():
                return 1  # the server has said why
            command = [sys.executable, "-m", "giirl", "train", str(HERE / "config.toml"), *sys.argv[1:]]
            return subprocess.run(command, cwd=HERE.parent.parent, check=False).returncode
        finally:
            server.terminate()
            server.wait(timeout=STOP_TIMEOUT_S)


if __name__ == "__main__":
    sys.exit(main())
