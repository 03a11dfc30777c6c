"""Recording of demonstrations by a person in a visible Chrome window."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from typing import Protocol

from browser_farm.chrome.devtools import BrowserGone
from browser_farm.chrome.launcher import check_screen
from browser_farm.human.recorder import Recorder
from browser_farm.human.site_recorder import SiteRecorder
from browser_farm.human.steps import Interrupted
from browser_farm.mixed import check_task
from browser_farm.sites.task_file import is_site
from giirl_core.config.sections import Sandbox
from giirl_core.progress import Display
from giirl_core.types import Episode, EpisodeSpec, Purpose, page_seed

MAX_LOST = 5  # episodes in a row


class PageRecorder(Protocol):
    """Shows a page until a person has ended its episode, see `browser_farm.human`."""

    def record(
        self, spec: EpisodeSpec, show_instruction: Callable[[str], None], progress: str = "", note: str = ""
    ) -> Episode | None: ...


def record(
    tasks: Sequence[str], per_task: int, seed: int, display: Display, have: Sequence[Episode] = ()
) -> Iterator[Episode]:
    """Show pages until there are `per_task` episodes of each task; the finished ones come one by one.

    `have` are those of an earlier recording: they count, and their pages are not shown again. Ctrl-C or closing the
    window ends the recording early. ValueError for a wrong task, or without a screen.
    """
    check_recordable(tasks)
    return _recorded(tasks, per_task, seed, display, have)


def check_recordable(tasks: Sequence[str]) -> None:
    """ValueError for a task that cannot be recorded, and without a screen."""
    for task in tasks:
        check_task(task)
        if task.startswith("flight."):
            raise ValueError(f"{task} cannot be recorded: its site is in a frame, wanted a task with a single page")
    check_screen()


def _recorded(
    tasks: Sequence[str], per_task: int, seed: int, display: Display, have: Sequence[Episode]
) -> Iterator[Episode]:
    for _, group in itertools.groupby(tasks, is_site):
        own = list(group)
        with closing(open_recorder(own)) as recorder:
            for task in own:
                seen = {e.trajectory.seed for e in have if e.trajectory.task == task}
                seeds = (page_seed(Purpose.DEMONSTRATE, seed, index) for index in itertools.count())
                pages = (EpisodeSpec(task=task, seed=one) for one in seeds if one not in seen)
                complete = yield from watch(recorder, pages, len(seen), per_task, display)
                if isinstance(recorder, SiteRecorder) and recorder.unset_variables:
                    names = ", ".join(recorder.unset_variables)
                    display.say(f"passwords are not stored: set {names} to play these demonstrations again")
                if not complete:
                    return


def open_recorder(tasks: Sequence[str], chrome_sandbox: Sandbox = "auto") -> Recorder | SiteRecorder:
    """The recorder of tasks of one kind: its windows are open."""
    if is_site(tasks[0]):
        return SiteRecorder(tasks, chrome_sandbox=chrome_sandbox)
    return Recorder(chrome_sandbox=chrome_sandbox)


def watch(
    recorder: PageRecorder, pages: Iterable[EpisodeSpec], have: int, wanted: int, display: Display
) -> Generator[Episode, None, bool]:
    """Record pages until there are `wanted` episodes, failed ones included; yields each. `have` are there already.

    The generator returns False if the person ended the recording before that. RuntimeError, one line, if no page opens
    or many in a row break.
    """
    kept, lost, note = have, 0, ""
    for page in pages:
        if kept >= wanted:
            break
        where = f"{page.task} {kept + 1}/{wanted}"
        try:
            episode = recorder.record(
                page,
                lambda goal, where=where: display.say(f"{where}  {goal}"),  # type: ignore[misc]
                f"{kept} of {wanted} recorded",
                note,
            )
        except Interrupted as error:
            lost, note = lost + 1, f"The last one was lost: {error}"
            display.say(f"{where}  lost: {error}")
            if lost == MAX_LOST:
                raise RuntimeError(f"{page.task}: {lost} episodes in a row were lost, the last one: {error}") from error
        except BrowserGone as error:
            display.say(f"{where}  ended: {error}")
            return False
        except KeyboardInterrupt:
            display.say("stopped")
            return False
        else:
            lost, said = 0, _verdict(episode)
            note = f"The last one {said}."
            display.say(f"{where}  {said}")
            if episode is not None:
                kept += 1
                yield episode
    return True


def _verdict(episode: Episode | None) -> str:
    """What became of an episode, and what a person should know about it."""
    if episode is None:
        return "was discarded"
    verdict = "succeeded" if episode.outcome.success else "failed"
    unlearnable = episode.trajectory.unlearnable()
    return f"{verdict}, but cannot be learned from: {unlearnable}" if unlearnable else verdict
