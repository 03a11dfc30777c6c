"""Recording of demonstrations by a person in a visible Chrome window."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing

from browser_farm.chrome.devtools import BrowserGone
from browser_farm.human.recorder import Interrupted, Recorder
from browser_farm.sites.task_file import is_site
from browser_farm.tasks import page_url
from giirl_core.progress import Display
from giirl_core.types import Episode, EpisodeSpec, Purpose, page_seed


def record(tasks: Sequence[str], per_task: int, seed: int, display: Display) -> Iterator[Episode]:
    """Show `per_task` pages of each task; the finished episodes come one by one.

    Ctrl-C or closing the window ends the recording early. ValueError without a screen.
    """
    check_recordable(tasks)
    pages = [
        EpisodeSpec(task=task, seed=page_seed(Purpose.DEMONSTRATE, seed, index))
        for task in tasks
        for index in range(per_task)
    ]
    return _recorded(pages, display)


def check_recordable(tasks: Sequence[str]) -> None:
    """ValueError for a task that cannot be recorded, and without a screen."""
    for task in tasks:
        if is_site(task):
            raise ValueError(
                f"{task} cannot be recorded: wanted a MiniWoB task; its scripted expert makes demonstrations"
            )
        page_url(task)
        if task.startswith("flight."):
            raise ValueError(f"{task} cannot be recorded: its site is in a frame, wanted a task with a single page")
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ValueError("there is no screen: DISPLAY is not set, wanted a desktop or xvfb-run")


def _recorded(pages: Sequence[EpisodeSpec], display: Display) -> Iterator[Episode]:
    with closing(Recorder()) as recorder:
        yield from watch(recorder, pages, display)


def watch(recorder: Recorder, pages: Sequence[EpisodeSpec], display: Display) -> Iterator[Episode]:
    """Record each page in turn; yields the finished episodes, failed ones included."""
    for number, page in enumerate(pages, start=1):
        where = f"{page.task} {number}/{len(pages)}"
        try:
            episode = recorder.record(page, lambda goal, where=where: display.say(f"{where}  {goal}"))  # type: ignore[misc]
        except Interrupted as error:
            display.say(f"{where}  lost: {error}")
        except BrowserGone as error:
            display.say(f"{where}  ended: {error}")
            return
        except KeyboardInterrupt:
            display.say("stopped")
            return
        else:
            if episode is not None:
                display.say(f"{where}  {'succeeded' if episode.outcome.success else 'failed'}")
                yield episode
