"""The installed MiniWoB tasks and the URLs of their pages."""

from __future__ import annotations

import difflib
import functools
import importlib.util
from pathlib import Path
from urllib.parse import urljoin, urlsplit
from urllib.request import url2pathname

# Pages whose state survives a reset in JavaScript (a widget, the value of a field, a price). They are reloaded for each
# episode; for all other pages the reset is enough.
STATEFUL_TASKS = frozenset(
    {
        "book-flight",
        "book-flight-nodelay",
        "choose-date",
        "choose-date-easy",
        "choose-date-medium",
        "drag-cube",
        "drag-items",
        "drag-items-grid",
        "drag-sort-numbers",
        "form-sequence",
        "hot-cold",
        "scroll-text",
        "scroll-text-2",
        "use-autocomplete",
        "use-autocomplete-nodelay",
        "use-colorwheel",
        "use-colorwheel-2",
        "use-slider",
        "use-slider-2",
        "use-spinner",
    }
)


@functools.cache
def pages_directory() -> Path:
    """The folder of pages inside the installed `miniwob` package, found without importing it."""
    spec = importlib.util.find_spec("miniwob")
    if spec is None or not spec.submodule_search_locations:
        raise ValueError("the miniwob package is not installed: pip install 'miniwob>=1.1,<1.2'")
    return Path(spec.submodule_search_locations[0]) / "html"


@functools.cache
def _pages() -> dict[str, Path]:
    """Task name -> page. MiniWoB++ tasks are named by their file, `flight.X` by the folder of an airline's site."""
    html = pages_directory()
    miniwob = {path.stem: path for path in html.glob("miniwob/*.html")}
    flights = {f"flight.{path.parent.name}": path for path in html.glob("flight/*/wrapper.html")}
    return dict(sorted({**miniwob, **flights}.items()))


def tasks(family: str = "") -> tuple[str, ...]:
    """All installed tasks, sorted, or those of a family: `click-tab` is click-tab, click-tab-2 and so on.

    ValueError when the family is empty.
    """
    names = tuple(_pages())
    chosen = tuple(
        name for name in names if not family or name == family or name.startswith((f"{family}-", f"{family}."))
    )
    if not chosen:
        page_url(family)
    return chosen


def page_url(task: str, base_url: str = "") -> str:
    """The URL of a task's page in the installed package, or in the folder `base_url`.

    ValueError with the nearest name when there is no such task.
    """
    if base_url:
        return _url_below(base_url, task)
    path = _pages().get(task)
    if path is None:
        near = difflib.get_close_matches(task, _pages(), n=1, cutoff=0.0)
        raise ValueError(f"there is no MiniWoB task {task!r}: did you mean {near[0]!r}? ({len(_pages())} tasks)")
    return path.as_uri()


def _url_below(base_url: str, task: str) -> str:
    """The URL of a task's page in a folder as the miniwob package has them; ValueError for one that is not there."""
    name = f"{task.replace('.', '/')}/wrapper.html" if task.startswith("flight.") else f"{task}.html"
    url = urljoin(base_url, name)
    parts = urlsplit(url)
    of_server = parts.scheme in ("http", "https") and parts.hostname
    if not (base_url.endswith("/") and (parts.scheme == "file" or of_server)):
        raise ValueError(f"base_url is {base_url!r}: wanted a folder's file:// or http:// URL, with a slash at its end")
    if parts.scheme == "file" and not Path(url2pathname(parts.path)).is_file():
        raise ValueError(f"base_url {base_url} has no page of the task {task!r}: there is no file {parts.path}")
    return url


def needs_fresh_document(task: str) -> bool:
    """Whether the task's page must be reloaded for the same seed to give the same page."""
    return task in STATEFUL_TASKS
