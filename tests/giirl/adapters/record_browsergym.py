"""Records observations of BrowserGym on MiniWoB pages: python -m tests.giirl.adapters.record_browsergym

It needs browsergym-core and browsergym-miniwob (the dependency group `browsergym` in pyproject.toml), which need not be
in the environment of the project, and a Chrome that GIIRL_CHROME names, by default `chromium`. Beside each observation
stands the page as our own farm reads it: BrowserGym draws the seed of a page with numpy.
"""

from __future__ import annotations

import gzip
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import miniwob
import numpy as np

from browser_farm import ChromeFarm, EpisodeSpec, Page

FIXTURE = Path(__file__).parent / "fixtures" / "browsergym.json.gz"
MEASURED, MEASURED_PAGES = "click-button", 24
OTHERS = ("click-link", "enter-text", "click-checkboxes", "choose-list", "login-user", "click-option", "click-tab")
OTHER_PAGES = 3
KEPT = ("goal", "dom_object", "focused_element_bid")
COLUMNS = ("tag", "text", "value", "classes", "parent", "box", "attributes", "focused")
CHROME = shutil.which(os.environ.get("GIIRL_CHROME", "chromium")) or "chromium"


@contextmanager
def browsergym(task: str) -> Iterator[Any]:
    """BrowserGym's environment of a MiniWoB task, on this machine's Chrome."""
    pages = Path(miniwob.__file__).parent / "html" / "miniwob"
    os.environ["MINIWOB_URL"] = f"{pages.as_uri()}/"
    import browsergym.miniwob.all as tasks
    from browsergym.core.env import BrowserEnv
    from playwright.sync_api import BrowserType

    launch = BrowserType.launch
    BrowserType.launch = lambda self, **options: launch(self, executable_path=CHROME, **options)
    name = "".join(part.capitalize() for part in task.split("-")) + "Task"
    env = BrowserEnv(getattr(tasks, name), pre_observation_delay=0.1)
    try:
        yield env
    finally:
        env.close()
        BrowserType.launch = launch


def farm_page(farm: ChromeFarm, task: str, seed: int) -> Page:
    """The page that BrowserGym shows for a seed, as our farm reads it."""
    drawn = int(np.random.RandomState(seed).randint(0, 1_000_000))
    return farm.reset({0: EpisodeSpec(task=task, seed=drawn)})[0].page


def columns(page: Page) -> dict[str, list[Any]]:
    """The columns that an observation has too."""
    found = {name: getattr(page, name) for name in COLUMNS}
    return {name: value.tolist() if isinstance(value, np.ndarray) else list(value) for name, value in found.items()}


def record() -> list[dict[str, Any]]:
    """Task, seed, observation and columns of the farm's page, for every page."""
    rows = []
    farm = ChromeFarm(tabs=1)
    try:
        for task in (MEASURED, *OTHERS):
            with browsergym(task) as env:
                for seed in range(MEASURED_PAGES if task == MEASURED else OTHER_PAGES):
                    observation, _ = env.reset(seed=seed)
                    kept = {key: observation[key] for key in KEPT}
                    page = columns(farm_page(farm, task, seed))
                    rows.append({"task": task, "seed": seed, "observation": kept, "page": page})
    finally:
        farm.close()
    return rows


if __name__ == "__main__":
    FIXTURE.parent.mkdir(exist_ok=True)
    FIXTURE.write_bytes(gzip.compress(json.dumps(record()).encode(), mtime=0))
