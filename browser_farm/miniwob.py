"""The MiniWoB tasks that are installed, and where their pages lie."""

from __future__ import annotations

import difflib
import functools
import importlib.util
from pathlib import Path

# Pages that carry something over to the next episode; everywhere else a reset in JavaScript is enough.
STICKY = frozenset(
    {
        "book-flight",
        "book-flight-nodelay",
        "choose-date",
        "drag-cube",
        "drag-items",
        "drag-sort-numbers",
        "form-sequence",
        "scroll-text",
        "scroll-text-2",
        "use-autocomplete-nodelay",
        "use-colorwheel",
        "use-colorwheel-2",
        "use-slider",
        "use-slider-2",
    }
)


@functools.cache
def pages_directory() -> Path:
    """The folder of task pages inside the installed `miniwob` package, found without importing it."""
    found = importlib.util.find_spec("miniwob")
    if found is None or not found.submodule_search_locations:
        raise ValueError("the miniwob package is not installed: pip install 'miniwob>=1.1,<1.2'")
    return Path(found.submodule_search_locations[0]) / "html" / "miniwob"


@functools.cache
def tasks() -> tuple[str, ...]:
    """Every task that can be opened, sorted."""
    return tuple(sorted(path.stem for path in pages_directory().glob("*.html")))


def page_url(task: str) -> str:
    """The file:// address of a task's page; ValueError with the nearest name when there is no such task."""
    if task not in tasks():
        near = difflib.get_close_matches(task, tasks(), n=1, cutoff=0.0)
        raise ValueError(f"there is no MiniWoB task {task!r}: did you mean {near[0]!r}? ({len(tasks())} tasks)")
    return (pages_directory() / f"{task}.html").as_uri()


def needs_fresh_document(task: str) -> bool:
    """True where the same seed gives the same page only in a document that was just loaded."""
    return task in STICKY
