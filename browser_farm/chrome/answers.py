"""What comes back from pages: a value, or why there is none."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from browser_farm.chrome.devtools import Reply


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """Why a tab gave no value: `page_hung`, `tab_crashed`, `navigated` or `page_error`, and in words."""

    cause: str
    words: str = ""


def answers_of(reply: Reply, tabs: list[int]) -> dict[int, Any | Failure]:
    """What each of these tabs said in the answer of their hub."""
    said = evaluated(reply)
    if isinstance(said, Failure):
        return dict.fromkeys(tabs, said)
    answers: dict[int, Any | Failure] = {}
    for tab, words in json.loads(said):
        wrong = words.get("error") if isinstance(words, dict) else None
        answers[tab] = words if wrong is None else Failure(cause="page_error", words=str(wrong))
    return answers


def evaluated(reply: Reply) -> str | Failure:
    """The string that an expression gave."""
    if reply.error:  # the document went away while it was asked
        return Failure(cause="navigated", words=reply.error)
    details = reply.result.get("exceptionDetails")
    if details is not None:
        words = details.get("exception", {}).get("description", details.get("text", ""))
        return Failure(cause="page_error", words=str(words).splitlines()[0] if words else "")
    return str(reply.result["result"].get("value", ""))
