"""Actors and learner in two network namespaces, with CURVE keys, and a cable between them that is cut and mended.

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
from tests.chaos.crowd import crowd, read_version
from tests.chaos.namespaces import HOSTS, Cable, cable
from tests.chaos.storm import settle_accounts, start
from tests.chaos.trainer import train

PORT = 5555
ACTORS = 8
UNTIL_S = 60.0


def main() -> None:
    folder, cut_s = Path(sys.argv[1]), float(sys.argv[2])
    keys = Keys.generate()
    with cable() as line:
        pids = [
            start("trainer", lambda: _train(line, folder, keys)),
            start("crowd", lambda: _play(line, folder, keys)),
        ]
        try:
            _until_step(folder, 20)
            line.cut()
            time.sleep(1.0)  # for what was on its way
            before = read_version(folder)
            time.sleep(cut_s)
            during = read_version(folder)
            line.mend()
            since_s = time.monotonic()
            _until_step(folder, during + 1)
            back_s = time.monotonic() - since_s
            _until_step(folder, during + 20)
            for pid in reversed(pids):
                os.kill(pid, signal.SIGTERM)
                assert os.waitpid(pid, 0)[1] == 0
            pids = []
        finally:
            for pid in pids:
                os.kill(pid, signal.SIGKILL)
    seen = {"steps_while_cut": during - before, "back_s": round(back_s, 2), "ledger": settle_accounts(folder)}
    (folder / "cut.json").write_text(json.dumps(seen, indent=2) + "\n")


def _train(line: Cable, folder: Path, keys: Keys) -> None:
    line.enter("learner")
    train(folder, PORT, host=HOSTS["learner"], keys=keys)


def _play(line: Cable, folder: Path, keys: Keys) -> None:
    line.enter("actors")
    crowd(folder, f"{HOSTS['learner']}:{PORT}", range(ACTORS), 0, keys=keys)


def _until_step(folder: Path, step: int) -> None:
    deadline_s = time.monotonic() + UNTIL_S
    while read_version(folder) < step:
        if time.monotonic() > deadline_s:
            raise AssertionError(f"step {read_version(folder)} after {UNTIL_S} s, wanted {step}")
        time.sleep(0.02)


if __name__ == "__main__":
    main()
