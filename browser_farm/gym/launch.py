"""Opens the farm of an environment, and checks the arguments that single and vector environment share."""

from __future__ import annotations

import math
from dataclasses import replace

from browser_farm.farm import ChromeFarm
from browser_farm.gym.elements import ELEMENTS
from giirl_core.config.sections import Sandbox


def open_farm(
    tabs: int,
    *,
    render_mode: str | None,
    base_url: str | None,
    wait_ms: float,
    real_time: bool,
    trusted: bool,
    call_timeout_s: float,
    chrome_sandbox: Sandbox,
) -> ChromeFarm:
    """A farm whose pages are read as the package reads them; ValueError for a wait that no call would outlast."""
    if not (math.isfinite(wait_ms) and 0 <= wait_ms < 1000 * call_timeout_s):
        raise ValueError(
            f"wait_ms is {wait_ms}: wanted 0 or more, and less than the {1000 * call_timeout_s:g} ms of call_timeout_s"
        )
    return ChromeFarm(
        tabs=tabs,
        view=replace(ELEMENTS, real_time=real_time, wait_ms=wait_ms),
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
