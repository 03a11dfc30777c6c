"""Opens the browser that a config names."""

from __future__ import annotations

from browser_farm import fake
from browser_farm import tasks as miniwob
from browser_farm.fake import FakeFarm
from browser_farm.farm import ChromeFarm
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.types import Browser


def open_browser(config: Config, metrics: Metrics) -> Browser:
    """Start the browser and wait until it is ready. `metrics` counts its restarts by cause."""
    if config.browser == "fake":
        return FakeFarm(tabs=config.actors.tabs)
    return ChromeFarm(
        tabs=config.actors.tabs,
        call_timeout_s=config.actors.call_timeout_s,
        launch_timeout_s=config.actors.launch_timeout_s,
        on_restart=lambda cause: metrics.browser_recoveries.labels(cause).inc(),
    )


def check_tasks(config: Config) -> None:
    """Raise ValueError, naming the nearest task, if the browser does not have one of the config's tasks."""
    for task in config.tasks:
        if config.browser == "fake":
            fake.check_task(task)
        else:
            miniwob.page_url(task)
