"""Opens the farm of an environment, and checks the arguments that single and vector environment share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from browser_farm.farm import ChromeFarm
from browser_farm.gym.elements import AGENT_ELEMENTS, ELEMENTS
from browser_farm.gym.own_pages import OwnPagesFarm
from browser_farm.sites.task_file import is_site
from giirl_core.config.sections import Sandbox


def open_farm(
    tasks: Sequence[str],
    tabs: int,
    *,
    render_mode: str | None,
    base_url: str | None,
    wait_ms: float,
    real_time: bool,
    agent_page: bool,
    trusted: bool,
    call_timeout_s: float,
    chrome_sandbox: Sandbox,
) -> ChromeFarm | OwnPagesFarm:
    """A farm whose pages are in the package's format: MiniWoB's, or those of task files.

    ValueError for a wait that no call would outlast, for tasks of both kinds, and for an argument that only MiniWoB's
    pages have.
    """
    if not (math.isfinite(wait_ms) and 0 <= wait_ms < 1000 * call_timeout_s):
        raise ValueError(
            f"wait_ms is {wait_ms}: wanted 0 or more, and less than the {1000 * call_timeout_s:g} ms of call_timeout_s"
        )
    if any(map(is_site, tasks)):
        if not all(map(is_site, tasks)):
            raise ValueError(f"the tasks are {', '.join(tasks)}: wanted task files only, or MiniWoB's tasks only")
        if base_url is not None or wait_ms:
            raise ValueError("base_url and wait_ms are for MiniWoB's pages: a task file has `address` and `[wait]`")
        return OwnPagesFarm(
            tasks,
            tabs,
            headless=render_mode != "human",
            call_timeout_s=call_timeout_s,
            chrome_sandbox=chrome_sandbox,
        )
    return ChromeFarm(
        tabs=tabs,
        view=replace(
            ELEMENTS,
            reader=AGENT_ELEMENTS if agent_page else ELEMENTS.reader,
            real_time=real_time,
            wait_ms=wait_ms,
        ),
        base_url=base_url or "",
        headless=render_mode != "human",
        trusted=trusted,
        call_timeout_s=call_timeout_s,
        chrome_sandbox=chrome_sandbox,
    )


def checked_task(task: str | None, subdomain: str | None) -> str:
    """The task, under our name or under the package's; ValueError unless exactly one of both is given."""
    if (task is None) == (subdomain is None):
        raise ValueError(f"task is {task!r} and subdomain {subdomain!r}: wanted one of them, they are the same")
    return task if task is not None else str(subdomain)


def checked_render_mode(render_mode: str | None, modes: list[str]) -> str | None:
    """The render mode itself; ValueError when it is not one of `modes`."""
    if render_mode not in (None, *modes):
        raise ValueError(f"render_mode is {render_mode!r}, wanted {' or '.join(modes)}, or None")
    return render_mode


def is_due(refresh_freq: int, episode: int) -> bool:
    """Whether the page is loaded anew for this episode, counted from 1; a frequency of 0 never does."""
    return refresh_freq > 0 and episode % refresh_freq == 0
