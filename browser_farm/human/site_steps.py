"""Collects the steps of a person on a page of one's own, across documents and dialogs."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np

from browser_farm.human.passwords import Recorded
from browser_farm.human.steps import Step
from browser_farm.sites.page import CANCEL, OK, Dialog, decode
from giirl_core.types import Page, Verb

DIALOG = -1  # the document of the steps in dialogs
FIRST_REF = 1  # of the rows of a dialog


class SiteSteps:
    """The steps of one episode so far, in the order in which they began. `scale` is the number of units of a CSS px.

    A step's page is what a policy would have seen: the page when it was quiet after the step before, so where the
    person scrolled does not reveal what comes next; if it has changed since, the page when the person acted.
    """

    def __init__(self, scale: float) -> None:
        self._scale = scale
        self._steps: dict[tuple[int, int], Recorded] = {}  # document, number in the document
        self._quiet: Page | None = None
        self._dialogs = 0

    def __len__(self) -> int:
        return len(self._steps)

    @property
    def recorded(self) -> list[Recorded]:
        """All steps."""
        return list(self._steps.values())

    def see(self, page: Page) -> None:
        """Note what a policy would see now."""
        if self._quiet is None or not _same(self._quiet, page):
            self._quiet = page

    def take(self, document: int, message: str) -> None:
        """Take a message of site_recorder.js: a step that is new, has changed, or is none any more."""
        number, row, shown = json.loads(message)
        key = document, number
        if row is None or (shown is None and key not in self._steps):  # the latter began before the episode
            self._steps.pop(key, None)
            return
        if shown is not None:
            columns, hidden = shown
            page = self._before(decode(columns, self._scale).page)
        else:
            page, hidden = self._steps[key].step.page, self._steps[key].hidden
        *step, is_password = row
        made = self._step(page, step, document)
        self._steps[key] = Recorded(step=made, hidden=tuple(hidden), is_password=bool(is_password))

    def answer(self, dialog: Dialog, *, accepted: bool, text: str) -> None:
        """Add the answer to a dialog. `text` is what its field held."""
        if dialog.kind == "prompt" and accepted and text != dialog.text:
            self._add_dialog_step(dialog, Verb.TYPE, ("input_text", dialog.message), text)
            dialog = replace(dialog, text=text, typed=True)
        self._add_dialog_step(dialog, Verb.CLICK, ("button", OK if accepted else CANCEL))

    def _add_dialog_step(self, dialog: Dialog, verb: Verb, element: tuple[str, str], text: str = "") -> None:
        """A step on the row of a dialog that has this tag and text."""
        page = dialog.page(FIRST_REF)
        row = list(zip(page.tag, page.text, strict=True)).index(element)
        left, top, width, height = map(float, page.box[row])
        middle = (left + width / 2, top + height / 2)
        step = Step(page=page, verb=verb, ref=int(page.ref[row]), text=text, at=middle, by=(0.0, 0.0))
        self._dialogs += 1
        self._steps[DIALOG, self._dialogs] = Recorded(step=step, hidden=(), is_password=False)

    def _before(self, page: Page) -> Page:
        quiet, self._quiet = self._quiet, None
        return quiet if quiet is not None and _same(quiet, page) else page

    def _step(self, page: Page, row: list[Any], document: int) -> Step:
        verb, ref, text, *lengths = row
        x, y, dx, dy = (float(length) * self._scale for length in lengths)
        return Step(page=page, verb=Verb(verb), ref=int(ref), text=str(text), at=(x, y), by=(dx, dy), document=document)


def _same(one: Page, other: Page) -> bool:
    """Whether two pages have the same elements with the same content; positions and the focus may differ."""
    return (one.tag, one.text, one.value) == (other.tag, other.text, other.value) and np.array_equal(one.ref, other.ref)
