"""Turns DevTools replies into the values that pages return, or into the reason why there is none."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from browser_farm.chrome.devtools import Reply


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """Why a tab returned no value. `cause` is `page_hung`, `tab_crashed`, `navigated` or `page_error`."""

    cause: str
    message: str = ""

    @classmethod
    def hung(cls, timeout_s: float) -> Failure:
        return cls(cause="page_hung", message=f"no answer in {timeout_s:g} s")


def parse_evaluation(reply: Reply) -> str | Failure:
    """The string that a Runtime.evaluate call returned."""
    if reply.error:  # the document was replaced during the call
        return Failure(cause="navigated", message=reply.error)
    details = reply.result.get("exceptionDetails")
    if details is not None:
        message = details.get("exception", {}).get("description", details.get("text", ""))
        return Failure(cause="page_error", message=str(message).splitlines()[0] if message else "")
    return str(reply.result["result"].get("value", ""))


def parse_answers(answers: Iterable[tuple[int, Any]]) -> dict[int, Any | Failure]:
    """Each tab's answer from the (tab, answer) pairs of hub.js, where {"error": message} reports an exception."""
    parsed: dict[int, Any | Failure] = {}
    for tab, answer in answers:
        error = answer.get("error") if isinstance(answer, dict) else None
        parsed[tab] = answer if error is None else Failure(cause="page_error", message=str(error))
    return parsed
