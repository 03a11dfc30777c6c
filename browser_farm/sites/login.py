"""Stored logins: the cookies and local storage that a browser context has before its first page."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from typing import Any

from browser_farm.chrome.devtools import Json
from browser_farm.sites.task_file import SiteTask

FROM_ENVIRONMENT = "env:"
COOKIE_FIELDS = frozenset({"name", "value", "url", "domain", "path", "secure", "httpOnly", "sameSite", "expires"})


def login_calls(task: SiteTask, address: str) -> Sequence[tuple[str, Json]]:
    """The DevTools calls that log a new page in. ValueError if the stored login cannot be read.

    `address` is the first page of the episode.
    """
    login = task.file.login
    cookies: list[Json] = [
        {"name": name, "value": _value(task, name, value), "url": address} for name, value in login.cookies.items()
    ]
    calls: list[tuple[str, Json]] = []
    if login.file:
        state = _read_state(task)
        cookies += [{key: cookie[key] for key in COOKIE_FIELDS & cookie.keys()} for cookie in state.get("cookies", [])]
        items = {
            str(origin["origin"]): [[one["name"], one["value"]] for one in origin.get("localStorage", [])]
            for origin in state.get("origins", [])
        }
        if items:
            calls.append(("Page.addScriptToEvaluateOnNewDocument", {"source": _storage_script(items)}))
    if cookies:
        calls.append(("Network.setCookies", {"cookies": cookies}))
    return calls


def _value(task: SiteTask, name: str, value: str) -> str:
    if not value.startswith(FROM_ENVIRONMENT):
        return value
    variable = value.removeprefix(FROM_ENVIRONMENT)
    if variable not in os.environ:
        raise ValueError(f"{task.name}: the cookie {name} is {value}, and the environment has no {variable}")
    return os.environ[variable]


def _read_state(task: SiteTask) -> dict[str, Any]:
    path = task.folder / task.file.login.file
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(state, dict):
            raise ValueError(f"it holds {type(state).__name__}")
    except (OSError, ValueError) as error:
        raise ValueError(f"{task.name}: login.file {path} is no stored login: {error}") from None
    return state


def _storage_script(items: dict[str, list[list[str]]]) -> str:
    """Fills the local storage of each origin once, before the page's own scripts run."""
    return f"""(() => {{
      const items = {json.dumps(items)}[location.origin];
      if (!items || localStorage.getItem('giirl-login')) return;
      localStorage.setItem('giirl-login', '1');
      for (const [name, value] of items) localStorage.setItem(name, value);
    }})();"""
