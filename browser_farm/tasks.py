"""The MiniWoB tasks that are installed, and where their pages lie."""

from __future__ import annotations

import difflib
import functools
import importlib.util
from pathlib import Path

# Pages that carry something over to the next episode (the state of a widget, what a field held, a price):
# they are loaded anew for each. Everywhere else a reset in JavaScript is enough.
STICKY = frozenset(
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
    found = importlib.util.find_spec("miniwob")
    if found is None or not found.submodule_search_locations:
        raise ValueError("the miniwob package is not installed: pip install 'miniwob>=1.1,<1.2'")
    return Path(found.submodule_search_locations[0]) / "html"


@functools.cache
def _pages() -> dict[str, Path]:
    """Every task and its page: those of MiniWoB++ by their file, `flight.X` by the folder of an airline's site."""
    html = pages_directory()
    plain = {path.stem: path for path in html.glob("miniwob/*.html")}
    flights = {f"flight.{path.parent.name}": path for path in html.glob("flight/*/wrapper.html")}
    return dict(sorted({**plain, **flights}.items()))


def tasks(family: str = "") -> tuple[str, ...]:
    """Every task that can be opened, sorted; or those of a family: `click-tab` is click-tab, click-tab-2 and so on."""
    names = tuple(_pages())
    chosen = tuple(
        name for name in names if not family or name == family or name.startswith((f"{family}-", f"{family}."))
    )
    if not chosen:
        page_url(family)
    return chosen


def page_url(task: str) -> str:
    """The file:// address of a task's page; ValueError with the nearest name when there is no such task."""
    found = _pages().get(task)
    if found is None:
        near = difflib.get_close_matches(task, _pages(), n=1, cutoff=0.0)
        raise ValueError(f"there is no MiniWoB task {task!r}: did you mean {near[0]!r}? ({len(_pages())} tasks)")
    return found.as_uri()


def needs_fresh_document(task: str) -> bool:
    """True where the same seed gives the same page only in a document that was just loaded."""
    return task in STICKY
