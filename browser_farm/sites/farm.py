"""Real Chrome behind the `Browser` protocol for tasks on pages of one's own: real time, one browser context each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from types import TracebackType
from typing import TypeVar

from browser_farm.chrome.answers import Failure
from browser_farm.chrome.devtools import BrowserGone, DevTools, Json
from browser_farm.sites.browser import SiteBrowser
from browser_farm.sites.episode import FILES_REFUSED, Episode
from browser_farm.sites.page import WIDTH
from browser_farm.sites.routines import Routine, run_all
from browser_farm.sites.screenshot import png_of
from giirl_core.config.sections import Sandbox
from giirl_core.types import Command, EpisodeSpec, Observation, StepResult

T = TypeVar("T")
OPEN_ATTEMPTS = 4
# The application does not do what its task file says: a further attempt is for one that restarts.
APPLICATION_CAUSES = frozenset({"unreachable", "refused", "not_quiet", "missing", "login_expired", "outside"})
APPLICATION_ATTEMPTS = 2


class SiteFarm:
    """A `giirl_core.types.Browser` with `tabs` tabs for the task files `tasks`.

    Every episode has a browser context of its own, which ends with it: no cookie, storage or login outlives an episode.
    A failure costs its episode (`StepResult.lost`) and `on_restart` is called with its cause: those of `ChromeFarm`,
    "unreachable", "not_quiet", or "outside" for a program or a request that failed. `on_count` is called with
    "elements_left_out" of a large page, "requests_refused", "file_inputs_refused" and "script_errors", and how many.

    Raises ValueError for a wrong argument or task, RuntimeError when Chrome does not start.
    """

    def __init__(
        self,
        tasks: Sequence[str],
        *,
        tabs: int = 8,
        call_timeout_s: float = 10.0,
        launch_timeout_s: float = 60.0,
        headless: bool = True,
        chrome_sandbox: Sandbox = "auto",
        on_restart: Callable[[str], None] = lambda cause: None,
        on_count: Callable[[str, int], None] = lambda what, count: None,
    ) -> None:
        if tabs < 1:
            raise ValueError(f"SiteFarm.tabs is {tabs}: wanted at least 1")
        self.tabs = tabs
        self._call_timeout_s = call_timeout_s
        self._on_restart, self._on_count = on_restart, on_count
        self._counted = 0  # refused requests
        self._episodes: dict[int, Episode] = {}
        self.unopened: dict[int, str] = {}
        self._lost: dict[int, str] = {}  # tab -> why its episode was lost, until the next step reports it
        self._browser = SiteBrowser(
            tasks,
            headless=headless,
            sandbox=chrome_sandbox,
            call_timeout_s=call_timeout_s,
            launch_timeout_s=launch_timeout_s,
            on_event=self._on_event,
        )
        try:
            self._browser.launch()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> SiteFarm:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def refused(self) -> Counter[str]:
        """Requests that were refused, by host and port."""
        return self._browser.refuser.refused

    @property
    def chrome_directory(self) -> str:
        """The directory of this farm's Chrome, by which `reaper.processes` finds its processes."""
        return str(self._browser.chrome.directory)

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        """Open an episode in each tab."""
        self._check(episodes, episodes.values())
        self.unopened.clear()
        return self._open(dict(episodes))

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        """Act in each tab, and open the episodes that follow."""
        self._check(commands, [c.following for c in commands.values() if c.following is not None])
        self.unopened.clear()
        for tab in commands:
            if tab not in self._episodes and tab not in self._lost:
                raise ValueError(f"tab {tab} has no episode: call reset before step")
        playing = {tab: self._episodes[tab].step(c) for tab, c in commands.items() if tab in self._episodes}
        stepped = self._run(playing)
        results: dict[int, StepResult] = {}
        to_open: dict[int, EpisodeSpec] = {}
        for tab, command in commands.items():
            result = self._finish(tab, stepped.get(tab))
            results[tab] = result
            if result.observation is None and command.following is not None:
                to_open[tab] = command.following
        for tab, observation in self._open(to_open).items():
            results[tab] = replace(results[tab], observation=observation)
        return results

    def screenshot(self, tab: int, box: tuple[float, float, float, float], *, scale: float = 1.0) -> bytes:
        """PNG of a part of a tab: left, top, width, height in the units of `Page.box`, 160 to the viewport's width.

        It has `scale` pixels per unit, at least one for two CSS px. b"" for a tab that does not answer.
        """
        if tab not in self._episodes:
            return b""
        episode = self._episodes[tab]
        routine = png_of(episode.session, box, episode.task.file.viewport[0] / WIDTH, scale)
        outcome = self._run({tab: routine}).get(tab, b"")
        return outcome if isinstance(outcome, bytes) else b""

    def left_out(self, tab: int) -> int:
        """Elements of a tab's page that are not in its observation."""
        return self._episodes[tab].left_out if tab in self._episodes else 0

    def failing_scripts(self, tab: int) -> list[str]:
        """What the scripts of [end] and [success] throw on a tab's page."""
        outcome = self._run({tab: self._episodes[tab].failing_scripts()}).get(tab)
        return outcome if isinstance(outcome, list) else []

    def close(self) -> None:
        """End Chrome and the servers of the farm."""
        self._browser.close()

    # ---- episodes

    def _check(self, tabs: Iterable[int], episodes: Iterable[EpisodeSpec]) -> None:
        if not self._browser.is_open:
            raise RuntimeError("this SiteFarm is closed")
        for tab in tabs:
            if not 0 <= tab < self.tabs:
                raise ValueError(f"there is no tab {tab}: wanted 0 to {self.tabs - 1}")
        for spec in episodes:
            if spec.task not in self._browser.tasks:
                raise ValueError(f"{spec.task!r} is not a task of this farm: it has {', '.join(self._browser.tasks)}")

    def _finish(self, tab: int, outcome: StepResult | Failure | None) -> StepResult:
        """Take over the outcome of a step; an episode that has ended gives its context back."""
        if not isinstance(outcome, StepResult):
            cause = outcome.cause if outcome is not None else self._lost.pop(tab, "browser_died")
            self._end(tab)
            return StepResult(raw_reward=0.0, done=False, observation=None, lost=cause)
        if self._episodes[tab].left_out:
            self._on_count("elements_left_out", self._episodes[tab].left_out)
        if outcome.reason == FILES_REFUSED:
            self._on_count("file_inputs_refused", 1)
        if self._episodes[tab].script_error:
            self._on_count("script_errors", 1)
            self._episodes[tab].script_error = ""
        if outcome.observation is None:
            self._end(tab)
        return outcome

    def _end(self, tab: int) -> None:
        episode = self._episodes.pop(tab, None)
        if episode is not None:
            try:
                episode.session.close()
            except BrowserGone:
                return  # the next call launches another Chrome

    def _open(self, specs: dict[int, EpisodeSpec]) -> dict[int, Observation]:
        """Open an episode in each tab, again after a failure. `unopened` says why one did not open."""
        opened: dict[int, Observation] = {}
        attempts: Counter[int] = Counter()
        while missing := {tab: spec for tab, spec in specs.items() if tab not in opened and tab not in self.unopened}:
            outcomes = self._try_open(missing)
            for tab in missing:
                outcome = outcomes.get(tab) or Failure(cause="browser_died")
                if isinstance(outcome, Observation):
                    opened[tab] = outcome
                    self._lost.pop(tab, None)
                    continue
                attempts[tab] += 1
                limit = APPLICATION_ATTEMPTS if outcome.cause in APPLICATION_CAUSES else OPEN_ATTEMPTS
                self._end(tab)
                if attempts[tab] >= limit:
                    self.unopened[tab] = f"{specs[tab].task} does not open: {outcome.cause} {outcome.message}".rstrip()
            if not outcomes:  # Chrome has died, and what was open in it
                opened.clear()
        return opened

    def _try_open(self, specs: Mapping[int, EpisodeSpec]) -> dict[int, Observation | Failure]:
        routines: dict[int, Routine[Observation]] = {}
        for tab, spec in specs.items():
            self._end(tab)
            self._episodes[tab], routines[tab] = self._browser.begin(spec)
        return self._run(routines)

    def _run(self, routines: Mapping[int, Routine[T]]) -> dict[int, T | Failure]:
        """What the routines return. {} if Chrome has died; then all episodes are lost and another Chrome is there."""
        try:
            outcomes = run_all(self._tools, routines) if routines else {}
            failures = {tab: one for tab, one in outcomes.items() if isinstance(one, Failure)}
            if any(failure.cause == "page_hung" for failure in failures.values()):
                self._tools.check_alive(timeout_s=self._call_timeout_s / 2)
        except BrowserGone:
            self._relaunch()
            return {}
        for failure in failures.values():
            self._on_restart(failure.cause)
        if refused := self.refused.total() - self._counted:
            self._counted += refused
            self._on_count("requests_refused", refused)
        return outcomes

    # ---- Chrome

    @property
    def _tools(self) -> DevTools:
        return self._browser.tools

    def _relaunch(self) -> None:
        self._on_restart("browser_died")
        self._lost |= dict.fromkeys(self._episodes, "browser_died")
        self._episodes.clear()
        self._browser.launch()

    def _on_event(self, session: str, method: str, params: Json) -> None:
        for episode in self._episodes.values():
            episode.session.hear(session, method, params)
