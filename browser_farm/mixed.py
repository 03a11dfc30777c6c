"""Tasks of both kinds in one browser: MiniWoB's by their name, those on pages of one's own by their task file."""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from browser_farm import experts
from browser_farm.experts.page_view import PageView
from browser_farm.farm import ChromeFarm
from browser_farm.sites.farm import SiteFarm
from browser_farm.sites.task_file import SiteTask, is_site, load_task
from browser_farm.tasks import page_url
from giirl_core.config.sections import Sandbox
from giirl_core.types import Action, Browser, Command, EpisodeSpec, Observation, StepResult

Expert = Callable[[Observation], Action]


def check_task(task: str) -> None:
    """ValueError, one line, if there is no such task."""
    if is_site(task):
        load_task(task)
    else:
        page_url(task)


def is_measured(task: str) -> bool:
    """Whether success at the task is known. Training does not need it."""
    return not is_site(task) or load_task(task).measured


def expert_of(task: str) -> Expert:
    """The scripted expert of a task: MiniWoB's, or the function that the task file names. ValueError without one."""
    return _load_expert(task) if is_site(task) else experts.expert(task)


@functools.cache
def _load_expert(name: str) -> Expert:
    task = load_task(name)
    file, _, function_name = task.file.expert.rpartition(":")
    if not file:
        raise ValueError(f"{name} names no scripted expert: wanted expert = 'experts.py:function', or demos.path")
    function = getattr(_load_module(task, file), function_name, None)
    if not callable(function):
        raise ValueError(f"{name}: {task.folder / file} has no function {function_name}")

    def act(observation: Observation) -> Action:
        try:
            action = function(PageView(observation))
        except (ValueError, LookupError) as error:
            raise experts.NoAction(f"the expert has no action for {observation.episode}: {error}") from error
        assert isinstance(action, Action), f"{function_name} returned {action!r}, wanted an Action"
        return action

    return act


def _load_module(task: SiteTask, file: str) -> object:
    path = task.folder / file
    spec = importlib.util.spec_from_file_location(f"giirl_expert_{path.stem}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ValueError(f"{task.name}: there is no expert file {path}")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def open_farm(
    tasks: Sequence[str],
    *,
    tabs: int,
    call_timeout_s: float,
    launch_timeout_s: float,
    chrome_sandbox: Sandbox,
    on_restart: Callable[[str], None],
    headless: bool = True,
    on_count: Callable[[str, int], None] = lambda what, count: None,
) -> Browser:
    """The farm that plays these tasks. It is the one of their kind; only tasks of both kinds need both."""
    sites = [task for task in tasks if is_site(task)]
    farms: list[Browser] = []
    try:
        if len(sites) < len(tasks):
            farms.append(
                ChromeFarm(
                    tabs=tabs,
                    call_timeout_s=call_timeout_s,
                    launch_timeout_s=launch_timeout_s,
                    headless=headless,
                    chrome_sandbox=chrome_sandbox,
                    on_restart=on_restart,
                )
            )
        if sites:
            farms.append(
                SiteFarm(
                    sites,
                    tabs=tabs,
                    call_timeout_s=call_timeout_s,
                    launch_timeout_s=launch_timeout_s,
                    headless=headless,
                    chrome_sandbox=chrome_sandbox,
                    on_restart=on_restart,
                    on_count=on_count,
                )
            )
    except BaseException:
        for farm in farms:
            farm.close()
        raise
    return farms[0] if len(farms) == 1 else MixedFarm(*farms)


class MixedFarm:
    """A `giirl_core.types.Browser` over two: each tab is in the one that plays its current task."""

    def __init__(self, miniwob: Browser, sites: Browser) -> None:
        self._farms = (miniwob, sites)
        self._farm_of: dict[int, int] = {}  # tab -> the farm of its episode
        self.tabs = miniwob.tabs
        self.unopened: dict[int, str] = {}  # a call of this class is up to three of the farms, which forget theirs

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        """Open an episode in each tab."""
        self.unopened.clear()
        return self._open(episodes)

    def _open(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        opened: dict[int, Observation] = {}
        for number, farm in enumerate(self._farms):
            own = {tab: spec for tab, spec in episodes.items() if is_site(spec.task) == bool(number)}
            self._farm_of |= dict.fromkeys(own, number)
            if own:
                opened |= farm.reset(own)
                self.unopened |= farm.unopened
        return opened

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        """Act in each tab, and open the episodes that follow."""
        self.unopened.clear()
        results: dict[int, StepResult] = {}
        changing: dict[int, EpisodeSpec] = {}  # to the other farm, once the episode has ended
        for number, farm in enumerate(self._farms):
            own: dict[int, Command] = {}
            for tab, command in commands.items():
                if self._farm_of.get(tab, 0) != number:
                    continue
                own[tab] = command
                if command.following is not None and is_site(command.following.task) != bool(number):
                    changing[tab] = command.following
                    own[tab] = replace(command, following=None)
            if own:
                results |= farm.step(own)
                self.unopened |= farm.unopened
        ended = {tab: spec for tab, spec in changing.items() if results[tab].observation is None}
        for tab, observation in self._open(ended).items():
            results[tab] = replace(results[tab], observation=observation)
        return results

    def screenshot(self, tab: int, box: tuple[float, float, float, float], *, scale: float = 1.0) -> bytes:
        """A screenshot of a tab."""
        return self._farms[self._farm_of.get(tab, 0)].screenshot(tab, box, scale=scale)

    def close(self) -> None:
        """Close both."""
        for farm in self._farms:
            farm.close()
