"""Actors and learner in two network namespaces, with CURVE keys, and a link between them that is cut and restored.

python -m tests.chaos.cut FOLDER SECONDS writes FOLDER/cut.json.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path

from giirl_core.wire.transport import Keys
from tests.chaos.crowd import read_version, run_actors
from tests.chaos.namespaces import HOSTS, Link, open_link
from tests.chaos.storm import compute_ledger, start
from tests.chaos.trainer import train

PORT = 5555
ACTORS = 8
TIMEOUT_S = 60.0


def main() -> None:
    folder, cut_s = Path(sys.argv[1]), float(sys.argv[2])
    keys = Keys.generate()
    with open_link() as link:
        pids = [
            start("trainer", lambda: _train(link, folder, keys)),
            start("crowd", lambda: _run_actors(link, folder, keys)),
        ]
        try:
            _wait_for_step(folder, 20)
            link.cut()
            time.sleep(1.0)  # for messages in flight
            before_cut = read_version(folder)
            time.sleep(cut_s)
            after_cut = read_version(folder)
            link.restore()
            restored_s = time.monotonic()
            _wait_for_step(folder, after_cut + 1)
            back_s = time.monotonic() - restored_s
            _wait_for_step(folder, after_cut + 20)
            for pid in reversed(pids):
                os.kill(pid, signal.SIGTERM)
                assert os.waitpid(pid, 0)[1] == 0
            pids = []
        finally:
            for pid in pids:
                os.kill(pid, signal.SIGKILL)
    result = {
        "steps_while_cut": after_cut - before_cut,
        "back_s": round(back_s, 2),
        "ledger": compute_ledger(folder),
    }
    (folder / "cut.json").write_text(json.dumps(result, indent=2) + "\n")


def _train(link: Link, folder: Path, keys: Keys) -> None:
    link.enter("learner")
    train(folder, PORT, host=HOSTS["learner"], keys=keys)


def _run_actors(link: Link, folder: Path, keys: Keys) -> None:
    link.enter("actors")
    run_actors(folder, f"{HOSTS['learner']}:{PORT}", range(ACTORS), 0, keys=keys)


def _wait_for_step(folder: Path, step: int) -> None:
    deadline_s = time.monotonic() + TIMEOUT_S
    while read_version(folder) < step:
        if time.monotonic() > deadline_s:
            raise AssertionError(f"the learner is at step {read_version(folder)} after {TIMEOUT_S} s, wanted {step}")
        time.sleep(0.02)


if __name__ == "__main__":
    main()
