"""One episode on a page of one's own: it begins, acts, observes and ends as its task file says."""

from __future__ import annotations

import fnmatch
import json
import re
import time
import uuid
import zlib
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, TypeVar
from urllib.parse import quote, urljoin

import numpy as np

from browser_farm.chrome import trusted_input
from browser_farm.sites import outside
from browser_farm.sites.fields import fill, resolve
from browser_farm.sites.page import CANCEL, OK, WIDTH, decode
from browser_farm.sites.quiet import settle
from browser_farm.sites.routines import Routine, ScriptThrew, TabFailed, Wait, sleep
from browser_farm.sites.session import Session
from browser_farm.sites.task_file import Condition, SiteTask
from giirl_core.types import Command, EpisodeSpec, Goal, Observation, Page, StepResult, Verb

T = TypeVar("T")
PASSWORD = "input_password"  # tag of a password field
FILES_REFUSED = "file inputs are refused"  # as in site.js
APPEAR_POLL_S = 0.05
OUTSIDE_TIMEOUT_S = 60.0  # of a program or a request of a task file
FIRST_ERROR_STATUS = 400
FAILED_STATUS = 409  # as in Success.request
OK_STATUS = range(200, 300)


@dataclass(frozen=True, slots=True)
class Drawn:
    """What a seed draws: the instruction, and the value of each place in the templates of the task file."""

    goal: Goal
    values: dict[str, str]


def draw(task: SiteTask, seed: int) -> Drawn:
    """The instruction of a seed: the same for the same seed and task file. `episode` is new each time."""
    rng = np.random.default_rng([seed, zlib.crc32(task.path.name.encode())])
    values = {**task.fields.draw(rng), "seed": str(seed), "episode": uuid.uuid4().hex}
    sentences = task.file.instructions
    return Drawn(Goal(fill(sentences[int(rng.integers(len(sentences)))], values)), values)


class Episode:
    """An episode in a session. `address` is the task's address, with an origin also for local files."""

    def __init__(self, task: SiteTask, spec: EpisodeSpec, session: Session, address: str) -> None:
        self.task, self.spec, self.session = task, spec, session
        self.drawn = draw(task, spec.seed)
        self.address = fill(address, self.drawn.values, lambda value: quote(value, safe=""))
        self.left_out = 0  # elements of the last page that were not shown
        self.script_error = ""  # of the last condition whose script threw
        self.scale = WIDTH / task.file.viewport[0]
        self._next_ref = 1
        self._passwords: frozenset[int] = frozenset()  # refs of the password fields of the last page

    @property
    def dialog(self) -> str:
        """The message of the open dialog, "" without one."""
        return self.session.dialog.message if self.session.dialog is not None else ""

    # ---- the begin

    def begin(self, setup: list[tuple[str, dict[str, Any]]]) -> Routine[Observation]:
        """Open the first page; TabFailed says why there is none."""
        file, begin = self.task.file, self.task.file.begin
        if begin.command and (status := (yield from self._command(begin.command))):
            raise TabFailed("outside", f"begin.command ended with status {status}")
        if begin.request:
            status = yield from self._request(begin.request)
            if status >= FIRST_ERROR_STATUS:
                raise TabFailed("outside", f"begin.request {begin.request!r} was answered with status {status}")
        yield from self.session.open(setup)
        yield from self.session.navigate(self.address, file.wait.deadline_s)
        page = yield from self.look()
        if file.login.expired and (yield from self.holds(file.login.expired)):
            raise TabFailed("login_expired", f"the login has expired: the first page is {self.session.address}")
        if self.session.status >= FIRST_ERROR_STATUS:
            raise TabFailed("unreachable", f"{self.session.address} was answered with status {self.session.status}")
        if begin.script:
            yield from self.session.evaluate(f"{{{self._script(begin.script)}}}; true", in_page=True)
            page = yield from self.look()
        if begin.selector:
            yield from self._appear(begin.selector)
            page = yield from self.look()
        return self._observation(page)

    def _appear(self, selector: str) -> Routine[None]:
        deadline = time.monotonic() + self.task.file.wait.deadline_s
        while not (yield from self.holds(Condition(selector=selector))):
            if time.monotonic() >= deadline:
                waited = f"{self.task.file.wait.deadline_s:g} s"
                raise TabFailed("missing", f"{selector!r} did not appear on {self.session.address} within {waited}")
            yield from sleep(APPEAR_POLL_S)

    # ---- steps

    def step(self, command: Command) -> Routine[StepResult]:
        """Act, wait until the page is quiet, and observe. Success is measured once the episode has ended."""
        self.session.file_chooser, refused = False, len(self.session.refused)
        if self.session.dialog is not None:
            reason = yield from self._answer(command)
        else:
            reason = yield from self._act(command)
        self.session.traffic.touch()  # the page is quiet if nothing comes of the action for a while
        page = yield from self.look()
        if self.session.file_chooser:
            reason = FILES_REFUSED
        elif len(self.session.refused) > refused:
            reason = f"the origin of {self.session.refused[-1]} is not among the allowed"
        done = bool(self.task.file.end) and self.session.dialog is None and (yield from self.holds(self.task.file.end))
        reward = (yield from self.verdict(done=done)) if done or command.last else 0.0
        continues = None if done or command.last else self._observation(page)
        return StepResult(raw_reward=reward, done=done, observation=continues, reason=reason)

    def _act(self, command: Command) -> Routine[str]:
        """Perform an action with trusted input; returns why it was refused, or "". ACTIVATE is a click, or APPEND."""
        verb = command.verb
        if verb is Verb.ACTIVATE:
            verb = Verb.APPEND if command.text else Verb.CLICK
        text = self._secret(command.text) if command.ref in self._passwords else command.text
        at, by = ([length / self.scale for length in pair] for pair in (command.at, command.by))
        action = json.dumps([int(verb), command.ref, text, *at, *by, command.to])
        aim = yield from self.session.evaluate(f"giirl.aim(...{action})")
        if isinstance(aim, str):
            return aim
        if isinstance(aim, list):
            native = Command(verb=verb, ref=command.ref, text=text, by=(by[0], by[1]))
            yield from self.session.send_input(trusted_input.events(native, aim))
        return ""

    def _secret(self, text: str) -> str:
        """The password that a reference in a demonstration stands for."""
        try:
            return resolve(text, self.drawn.values)
        except ValueError as error:
            raise TabFailed("outside", str(error)) from error

    def _answer(self, command: Command) -> Routine[str]:
        """Act on an open dialog. What is no click, key or text for it has no effect."""
        dialog = self.session.dialog
        assert dialog is not None
        tag, text, _ = dialog.row_of(command.ref)
        button = text if tag == "button" and command.verb in (Verb.CLICK, Verb.DOUBLE_CLICK, Verb.ACTIVATE) else ""
        if command.verb is Verb.PRESS:
            button = {"Enter": OK, "Escape": dialog.buttons[-1]}.get(command.text, "")
        if tag == "input_text" and command.verb in (Verb.TYPE, Verb.APPEND):
            dialog.text = command.text if command.verb is Verb.TYPE else dialog.text + command.text
            dialog.typed = True
        if button:
            yield from self.session.answer(accept=button != CANCEL, text=dialog.text)
        return ""

    def look(self) -> Routine[Page]:
        """Wait until the page is quiet and read it; an open dialog is all that is seen."""
        file = self.task.file
        columns = yield from settle(self.session, file.wait, self._next_ref, file.max_elements)
        if columns is None:
            dialog = self.session.dialog
            assert dialog is not None
            page, self.left_out = dialog.page(dialog.first_ref or self._next_ref), 0
        else:
            try:
                read = decode(columns, self.scale)
            except (ValueError, TypeError, OverflowError) as error:
                raise TabFailed("page_error", str(error)) from error
            page, self.left_out = read.page, read.left_out
        self._next_ref = max(self._next_ref, 1 + int(page.ref.max(initial=0)))
        self._passwords = frozenset(int(page.ref[row]) for row, tag in enumerate(page.tag) if tag == PASSWORD)
        return page

    def _observation(self, page: Page) -> Observation:
        return Observation(episode=self.spec, page=page, goal=self.drawn.goal)

    # ---- the end

    def holds(self, condition: Condition) -> Routine[bool]:
        """Whether everything that the condition names holds. A script that throws does not: `script_error` is why."""
        if condition.address and not fnmatch.fnmatchcase(self.session.address, self._pattern(condition.address)):
            return False
        if condition.selector:
            found = yield from self.session.evaluate(f"giirl.has({json.dumps(condition.selector)})")
            if not found:
                return False
        if condition.script:
            try:
                return bool((yield from self.session.evaluate(self._script(condition.script), in_page=True)))
            except ScriptThrew as error:
                self.script_error = str(error)
                return False
        return True

    def verdict(self, *, done: bool) -> Routine[float]:
        """1 for success and -1 for failure, 0 at the step limit; of a task without a check, 1 if it ended by itself."""
        success = self.task.file.success
        if not success:
            return float(done)
        won = yield from self.holds(success)
        if won and success.command:
            won = (yield from self._command(success.command)) == 0
        if won and success.request:
            status = yield from self._request(success.request)
            if status not in OK_STATUS and status != FAILED_STATUS:
                raise TabFailed("outside", f"success.request was answered with status {status}")
            won = status != FAILED_STATUS
        return 1.0 if won else -float(done)

    def failing_scripts(self) -> Routine[list[str]]:
        """What the scripts of [end] and [success] throw on the present page."""
        errors: list[str] = []
        for name, condition in (("end", self.task.file.end), ("success", self.task.file.success)):
            self.script_error = ""
            yield from self.holds(Condition(script=condition.script))
            if self.script_error:
                errors.append(f"{name}.script: {self.script_error}")
        return errors

    # ---- outside the page

    def _command(self, template: tuple[str, ...]) -> Routine[int]:
        values, folder = {**self.drawn.values, "goal": self.drawn.goal.utterance}, self.task.folder
        command = [fill(word, values) for word in template]
        return (yield from _in_thread(lambda: outside.run_command(command, folder, values, OUTSIDE_TIMEOUT_S)))

    def _request(self, template: str) -> Routine[int]:
        method, _, target = template.partition(" ")
        path = fill(target, self.drawn.values, lambda value: quote(value, safe=""))
        address = urljoin(self.address, path)
        return (yield from _in_thread(lambda: outside.run_request(method, address, OUTSIDE_TIMEOUT_S)))

    def _script(self, template: str) -> str:
        """A script in which each {field} is a JavaScript string."""
        return fill(template, self.drawn.values, json.dumps)

    def _pattern(self, template: str) -> str:
        """A pattern in which the values of fields stand for themselves."""
        return fill(template, self.drawn.values, lambda value: re.sub(r"([*?[])", r"[\1]", quote(value, safe="")))


def _in_thread(function: Callable[[], T]) -> Routine[T]:
    """What a function returns that runs in a thread; TabFailed if it cannot do its work."""
    future: Future[T] = outside.executor.submit(function)
    yield Wait(future.done, time.monotonic() + 2 * OUTSIDE_TIMEOUT_S, polls=True)
    try:
        return future.result(timeout=0)
    except (outside.OutsideError, TimeoutError) as error:
        raise TabFailed("outside", str(error)) from error
