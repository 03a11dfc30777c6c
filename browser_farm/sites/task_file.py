"""Task files: a TOML file that declares a task on any pages, read and checked."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from browser_farm.sites.fields import DRAWN, Fields, check_template, read_fields
from browser_farm.sites.origins import is_http, origin_of
from giirl_core.config.sections import STRICT, Seconds

SUFFIX = ".toml"
METHODS = ("GET", "POST")
UNKNOWN_KEY = ("unexpected_keyword_argument", "extra_forbidden")  # types of pydantic's errors
EXPERT = re.compile(r"[^:]+\.py:\w+")

Milliseconds = Annotated[float, Field(gt=0)]
Pixels = Annotated[int, Field(ge=100, le=10_000)]
Command = Annotated[tuple[str, ...], Field(min_length=1)]
Texts = Annotated[tuple[str, ...], BeforeValidator(lambda value: (value,) if isinstance(value, str) else value)]


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class Condition:
    """What a page is asked; it holds if everything that is given holds."""

    selector: str = ""
    """A CSS selector of which an element is visible, also in frames of the same origin and in open shadow roots."""
    address: str = ""
    """A pattern of the page's address in which * stands for any text."""
    script: str = ""
    """A JavaScript expression in the page that is true."""

    def __bool__(self) -> bool:
        return bool(self.selector or self.address or self.script)


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class Begin:
    """How an episode begins, in this order; each part is optional. The address is opened in any case."""

    command: tuple[str, ...] = ()
    """A program with its arguments that runs before the page opens; it has to exit with status 0."""
    request: str = ""
    """A request before the page opens, "POST /reset?seed={seed}"; the reply has to have a status below 400."""
    script: str = ""
    """JavaScript that runs in the opened page."""
    selector: str = ""
    """A CSS selector that has to appear before the agent sees the page."""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class Success(Condition):
    """What success is. Read when an episode has ended and for measuring only: training never sees it."""

    command: tuple[str, ...] = ()
    """A program with its arguments: exit status 0 is success, 1 is failure, anything else is an error."""
    request: str = ""
    """A request: a status of 2xx is success, 409 is failure, anything else is an error."""

    def __bool__(self) -> bool:
        return bool(self.selector or self.address or self.script or self.command or self.request)


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class Login:
    """What a browser knows before the first page opens."""

    cookies: dict[str, str] = dataclasses.field(default_factory=dict)
    """Cookies of the address. "env:NAME" takes a value from the environment."""
    file: str = ""
    """A JSON file with `cookies` and the `localStorage` of `origins`, as Playwright's storage state."""
    expired: Condition = Condition()
    """What the first page shows when the login is not valid any more."""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class WaitRule:
    """When a step is over: no request is under way and the page has not changed for a while."""

    quiet_ms: Milliseconds = 100.0
    """Time without a request and without a change of the page. [ms]"""
    deadline_s: Seconds = 10.0
    """A page that is not quiet by then is an error. [s]"""
    ignore_elements: Texts = ()
    """CSS selectors of elements that may change at any time, as a clock."""
    ignore_addresses: Texts = ()
    """Patterns of requests that are not waited for, as those that ask for news."""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class TaskFile:
    """What a task file says."""

    address: str
    """The first page: http(s)://..., or an HTML file beside the task file, which the farm serves on loopback."""
    instructions: Annotated[Texts, Field(min_length=1)]
    """Templates with {field}, or plain sentences; one is drawn for each seed."""
    viewport: tuple[Pixels, Pixels] = (1024, 768)
    """Width and height of the page. [CSS px]"""
    origins: Texts = ()
    """Origins besides the address's own that the page may reach, "http://127.0.0.1:8001"."""
    max_elements: Annotated[int, Field(ge=10, le=5000)] = 300
    """Most elements that an agent sees of a page. [elements]"""
    expert: str = ""
    """A scripted expert for demonstrations, "experts.py:function"."""
    fields: dict[str, Any] = dataclasses.field(default_factory=dict)
    """The fields of the templates: a list, {from = 1, to = 9} or {csv = "file.csv", column = "name"}."""
    begin: Begin = Begin()
    end: Condition = Condition()
    success: Success = Success()
    login: Login = Login()
    wait: WaitRule = WaitRule()


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class SiteTask:
    """A task file that was read: what it says, where it lies and the values of its fields."""

    name: str  # as in the settings
    path: Path
    file: TaskFile
    fields: Fields

    @property
    def folder(self) -> Path:
        """The folder that the paths in the file are relative to."""
        return self.path.parent

    @property
    def measured(self) -> bool:
        """Whether the task says what success is."""
        return bool(self.file.success)

    @property
    def local_page(self) -> Path | None:
        """The HTML file of the address; None for an address on a server."""
        return None if is_http(self.file.address) else self.folder / re.split(r"[?#]", self.file.address)[0]


def is_site(task: str) -> bool:
    """Whether the name of a task is the path of a task file."""
    return task.endswith(SUFFIX)


@functools.cache
def load_task(name: str) -> SiteTask:
    """The task of a file, read once for each process; ValueError, one line, that says what is wrong where."""
    path = Path(name)
    try:
        tree = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"cannot read the task file {name}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{name} is not valid TOML: {error}") from None
    try:
        file = TypeAdapter(TaskFile).validate_python(tree)
    except ValidationError as error:
        raise ValueError(f"{name}: {_first_error(error)}") from None
    try:
        task = SiteTask(name=name, path=path, file=file, fields=read_fields(file.fields, path.parent))
        _check(task)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    return task


def _first_error(error: ValidationError) -> str:
    """One line about the first error: the key, what it is and what was wanted. A misspelt key comes before others."""
    first = min(error.errors(), key=lambda one: one["type"] not in UNKNOWN_KEY)
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] in UNKNOWN_KEY:
        near = difflib.get_close_matches(key, _keys(TaskFile), n=1, cutoff=0.0)
        return f"there is no key {key!r}; the nearest is {near[0]!r}"
    if first["type"] in ("missing_argument", "missing"):
        return f"the key {key!r} is missing"
    return f"{key} = {first['input']!r}: {first['msg']}"


def _keys(section: type[Any], prefix: str = "") -> list[str]:
    found = []
    for field in dataclasses.fields(section):
        found.append(prefix + field.name)
        if dataclasses.is_dataclass(field.default):
            found += _keys(type(field.default), f"{prefix}{field.name}.")
    return found


def _check(task: SiteTask) -> None:
    """ValueError for what the types do not say."""
    file, known = task.file, {*task.fields.names, *DRAWN}
    for index, sentence in enumerate(file.instructions):
        check_template(f"instructions[{index}]", sentence, known)
    check_template("address", file.address, known)
    for origin in file.origins:
        if origin_of(origin) != origin.rstrip("/"):
            raise ValueError(f"origins has {origin!r}: wanted scheme://host:port, as in http://127.0.0.1:8001")
    page = task.local_page
    if page is not None and not page.is_file():
        raise ValueError(f"address is {file.address!r}: wanted http://..., or an HTML file, and {page} is none")
    if page is not None and not page.resolve().is_relative_to(task.folder.resolve()):
        raise ValueError(
            f"address is {file.address!r}: wanted an HTML file in the folder of the task file, or below it"
        )
    for name, request in (("begin.request", file.begin.request), ("success.request", file.success.request)):
        method, _, target = request.partition(" ")
        if request and (method not in METHODS or not target):
            raise ValueError(
                f"{name} is {request!r}: wanted a method and an address, as in 'POST /reset?seed={{seed}}'"
            )
        check_template(name, request, known)
    for name, command in (("begin.command", file.begin.command), ("success.command", file.success.command)):
        for word in command:
            check_template(name, word, known)
    if file.expert and not EXPERT.fullmatch(file.expert):
        raise ValueError(f"expert is {file.expert!r}: wanted FILE.py:FUNCTION")
