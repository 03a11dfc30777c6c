"""A program whose worker processes on Ray all write the same warning: `python -m tests.end_to_end.warn COUNT`."""

from __future__ import annotations

import logging
import sys
import time

from giirl_core.config_file import dump_config, load_config
from giirl_core.processes.ray_platform import RayPlatform
from giirl_core.processes.supervision import Place
from giirl_core.processes.worker_process import WorkerProcess

PRINTED_S = 8.0  # Ray collects repeated lines for 5 s


class WarningProcess(WorkerProcess):
    KIND = "actor"

    def warn(self) -> None:
        logging.getLogger("actors").warning("rejected policy weights: version 3, wanted one after 4")


def main() -> None:
    config = load_config(None, ["runtime=local", "net.vectors=hashed", "browser=fake"])
    platform = RayPlatform(config, "run")
    names = [f"actor-{index}" for index in range(int(sys.argv[1]))]
    processes = [
        platform.start(WarningProcess, name, dump_config(config), "run", name, False, place=Place()) for name in names
    ]
    for process in processes:
        process.call("warn").result(60)
    time.sleep(PRINTED_S)
    platform.close()


if __name__ == "__main__":
    main()
