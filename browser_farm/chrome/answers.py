"""Turns DevTools replies into the values that pages return, or into the reason why there is none."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from browser_farm import pages
from browser_farm.chrome.devtools import Reply


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """Why a tab returned no value. `cause` is `page_hung`, `tab_crashed`, `navigated` or `page_error`."""

    cause: str
    message: str = ""

    def __str__(self) -> str:
        return f"{self.cause} {self.message}".rstrip()

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


def decode(outcome: Any | Failure, view: pages.View) -> pages.Answer | Failure:
    """The decoded answer of page.js, or why there is none."""
    if isinstance(outcome, Failure):
        return outcome
    if outcome == pages.GONE:
        return Failure(cause="navigated")
    try:
        return pages.decode(outcome, view)
    except (ValueError, TypeError, OverflowError) as error:
        return Failure(cause="page_error", message=str(error))


def pixels(png: bytes, width: int, height: int) -> NDArray[np.uint8]:
    """[height, width, 3] RGB of a PNG, which is resized if it has another size; black for b""."""
    if not png:
        return np.zeros((height, width, 3), dtype=np.uint8)
    image = Image.open(io.BytesIO(png)).convert("RGB")
    return np.array(image if image.size == (width, height) else image.resize((width, height)))
