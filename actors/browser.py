"""Opens the browser that a config names."""

from __future__ import annotations

import time
from collections.abc import Mapping

from browser_farm import fake, mixed
from browser_farm.fake import FakeFarm
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.types import Browser, Command, EpisodeSpec, Observation, StepResult


def open_browser(config: Config, metrics: Metrics, *, tabs: int = 0, headless: bool = True) -> Browser:
    """Start the browser and wait until it is ready; it has as many tabs as the config says, or `tabs`.

    `metrics` counts its restarts by cause.
    """
    tabs = tabs or config.actors.tabs
    if config.browser == "fake":
        browser: Browser = FakeFarm(tabs=tabs)
    else:
        browser = mixed.open_farm(
            config.tasks,
            tabs=tabs,
            call_timeout_s=config.actors.call_timeout_s,
            launch_timeout_s=config.actors.launch_timeout_s,
            chrome_sandbox=config.actors.chrome_sandbox,
            headless=headless,
            on_restart=lambda cause: metrics.browser_recoveries.labels(cause).inc(),
            on_count=lambda what, count: metrics.page_limits.labels(what).inc(count),
        )
    return SlowBrowser(browser, config.actors.step_delay_s) if config.actors.step_delay_s else browser


class SlowBrowser:
    """A browser whose steps take `delay_s` longer: simulates an application that responds slowly."""

    def __init__(self, browser: Browser, delay_s: float) -> None:
        self._browser, self._delay_s = browser, delay_s
        self.tabs = browser.tabs

    @property
    def unopened(self) -> Mapping[int, str]:
        """Why the pages of tabs did not open in the last call."""
        return self._browser.unopened

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        """Open episodes, without a delay."""
        return self._browser.reset(episodes)

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        """One step of every tab, after the delay: all respond at the same time."""
        time.sleep(self._delay_s)
        return self._browser.step(commands)

    def screenshot(self, tab: int, box: tuple[float, float, float, float], *, scale: float = 1.0) -> bytes:
        """A screenshot, without a delay."""
        return self._browser.screenshot(tab, box, scale=scale)

    def close(self) -> None:
        """Close the browser."""
        self._browser.close()


def check_tasks(config: Config) -> None:
    """Raise ValueError if the browser does not have one of the config's tasks, or cannot play its task file."""
    for task in config.tasks:
        if config.browser == "fake":
            fake.check_task(task)
        else:
            mixed.check_task(task)


def measured_tasks(config: Config) -> tuple[str, ...]:
    """The config's tasks whose success is known: a task file may leave it open, and training does not need it."""
    return tuple(task for task in config.tasks if config.browser == "fake" or mixed.is_measured(task))
