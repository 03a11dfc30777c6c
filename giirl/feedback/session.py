"""`giirl feedback`: plays episodes of a run in a thread, and serves them to a person until Ctrl-C."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from threading import Event

from giirl.feedback.desk import Desk
from giirl.feedback.page import Pages
from giirl.feedback.selector import Selector
from giirl.feedback.server import FeedbackServer
from giirl.feedback.stage import Stage
from giirl.run.folder import RunFolder
from giirl.run.record import check_recordable, open_recorder
from giirl.run.worlds import open_web_run, world_of
from giirl.signals import handling
from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config
from giirl_core.files import folder_lock, is_locked
from giirl_core.gestures import read_gestures

POLL_S = 0.5


def open_feedback_run(path: Path) -> tuple[RunFolder, Config]:
    """A run that can learn from people; ValueError for any other, and for one without a checkpoint."""
    folder, config = open_web_run(path)
    world_of(config).check(config)
    if not ALGORITHMS[config.algorithm].needs_demonstrations:
        raise ValueError(f"{path} has algorithm {config.algorithm!r}: no demonstration and no answer changes it")
    folder.latest_checkpoint()
    return folder, config


def give_feedback(folder: RunFolder, config: Config, port: int, on_ready: Callable[[str], None]) -> int:
    """Serve the page until Ctrl-C; returns the number of answers in the run's folder.

    ValueError if another process does the same, or if the port is in use; RuntimeError if nothing can be played.
    """
    folder.feedback.mkdir(exist_ok=True)
    desk, stop = Desk(folder.feedback), Event()
    with (
        folder_lock(folder.feedback),
        closing(_stage(config)) as stage,
        closing(FeedbackServer(desk, stage, Pages(config, folder.path.name), port)) as server,
        Selector(folder, config) as selector,
        ThreadPoolExecutor(1) as threads,
        handling(lambda number, frame: stop.set()),
    ):
        player = threads.submit(_keep_desk_full, desk, selector, stop)
        player.add_done_callback(lambda _: stop.set())
        try:
            server.serve(stop, on_ready)
        finally:
            stop.set()
        player.result()  # raises what has ended it
    return desk.answers


def _stage(config: Config) -> Stage:
    """The window in which people show the right way."""

    def check(task: str) -> None:
        if config.browser == "fake":
            raise ValueError("the fake browser has no window to show anything in")
        check_recordable([task])

    return Stage(
        lambda task: open_recorder([task], config.actors.chrome_sandbox), check, read_gestures(config.net.gestures)
    )


def _keep_desk_full(desk: Desk, selector: Selector, ended: Event) -> None:
    """Play until `ended`, whenever few episodes wait."""
    while not ended.is_set():
        if desk.wait_until_low(POLL_S):
            desk.offer(selector.choose(ended))


def how_to_learn(folder: RunFolder, config: Config) -> str:
    """How a run learns from the answers: as it goes on, or with which command."""
    if is_locked(folder.path):
        return "the run under way learns from them"
    checkpoint = folder.latest_checkpoint()
    done: int = json.loads((checkpoint / "learner.json").read_bytes())["version"]
    more = f" iterations={done + max(config.iterations // 3, 1)}" if done >= config.iterations else ""
    return f"to learn from them: giirl train --resume {folder.path}{more}"
