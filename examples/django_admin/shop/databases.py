"""A database for each episode: a copy of the template, chosen by the browser's cookie."""

from __future__ import annotations

import re
import shutil
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from django.conf import settings
from django.db import connections
from django.http import HttpRequest, HttpResponse

COOKIE = "episode"
TEMPLATE = "default"  # what every episode begins with
EPISODE = re.compile(r"[0-9a-f]{32}")
MOST = 200  # databases that are kept; the oldest is deleted

_current = threading.local()
_lock = threading.Lock()
_open: OrderedDict[str, None] = OrderedDict()  # episodes, the oldest first


class EpisodeRouter:
    """Sends every query of a request to the database of its episode."""

    def db_for_read(self, model: Any, **hints: Any) -> str:
        return getattr(_current, "alias", TEMPLATE)

    def db_for_write(self, model: Any, **hints: Any) -> str:
        return getattr(_current, "alias", TEMPLATE)

    def allow_relation(self, one: Any, other: Any, **hints: Any) -> bool:
        return True


def begin(episode: str) -> None:
    """Make the database of an episode; ValueError for a name that is none."""
    if not EPISODE.fullmatch(episode):
        raise ValueError(f"{episode!r} is not the id of an episode")
    path = settings.FOLDER / f"{episode}.sqlite3"
    shutil.copyfile(settings.TEMPLATE, path)
    with _lock:
        databases = {**connections.databases, episode: {**connections.databases[TEMPLATE], "NAME": str(path)}}
        _open[episode] = None
        old = _open.popitem(last=False)[0] if len(_open) > MOST else ""
        databases.pop(old, None)
        connections.settings = databases  # another dictionary: other threads may be going through the one before
    if old:
        (settings.FOLDER / f"{old}.sqlite3").unlink(missing_ok=True)


@contextmanager
def using(episode: str) -> Iterator[None]:
    """Inside the block, models are those of the episode's database, or of the template's. KeyError if there is none."""
    if episode != TEMPLATE and episode not in _open:
        raise KeyError(episode)
    before = getattr(_current, "alias", TEMPLATE)
    _current.alias = episode
    try:
        yield
    finally:
        _current.alias = before


def episode_middleware(respond: Callable[[HttpRequest], HttpResponse]) -> Callable[[HttpRequest], HttpResponse]:
    """Answers a request with the database that its cookie names; without one, with the template's."""

    def middleware(request: HttpRequest) -> HttpResponse:
        episode = request.COOKIES.get(COOKIE, "")
        if episode not in _open:
            return respond(request)
        with using(episode):
            return respond(request)

    return middleware
