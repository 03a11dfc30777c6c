"""Keeps typed passwords out of demonstrations: a reference to where each can be found is stored in its place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from browser_farm.human.steps import Step
from browser_farm.sites.fields import DRAWN
from giirl_core.types import NO_SPAN, Goal, Page, Verb

VARIABLE = "GIIRL_PASSWORD"  # and GIIRL_PASSWORD_2, ...: the variables of the environment that hold passwords
MASK = "•••"  # stands for what is in a password field and was not, or not yet, the password
WORD = 4  # characters: a shorter password is hidden where it stands alone, not inside other words
LONGEST = 200  # characters of a value that are read, as in site_reading.js


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """A step as it was recorded, with passwords in clear."""

    step: Step
    hidden: tuple[int, ...]  # rows of its page that are password fields
    is_password: bool  # its element is one


class Passwords:
    """The passwords of one recording and what is stored for each, the same for the same password.

    A password that is in the instruction stays: its words are typed from there. One that is the value of a field of the
    task file becomes {field}. Any other becomes {env:NAME}, a variable of `environment` that holds it, or one that has
    to be set before the demonstration is played again: those are in `unset`.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._variables = {value: name for name, value in environment.items() if name.startswith(VARIABLE) and value}
        self.unset: list[str] = []

    def hide(self, recorded: Sequence[Recorded], goal: Goal, values: Mapping[str, str]) -> list[Step]:
        """The steps without passwords. `values` are those of the fields that the instruction was drawn from."""
        typed = {one.step.text for one in recorded if one.is_password and one.step.verb is Verb.TYPE and one.step.text}
        stored = {password: self._reference(password, goal, values) for password in sorted(typed)}
        longest_first = sorted(stored.items(), key=lambda pair: -len(pair[0]))  # one may be the beginning of another
        secrets = {password: reference for password, reference in longest_first if password != reference}
        shown = {_as_read(password): reference for password, reference in stored.items()}

        def in_field(value: str) -> str:
            return shown.get(value) or (MASK if value and goal.find(value)[0] == NO_SPAN else value)

        def clean(text: str) -> str:
            for password, reference in secrets.items():
                if len(password) >= WORD:
                    text = text.replace(password, reference)
                elif text == password:
                    text = reference
            return text

        def page_of(one: Recorded) -> Page:
            page = one.step.page
            value = tuple(in_field(v) if row in one.hidden else clean(v) for row, v in enumerate(page.value))
            return replace(
                page,
                text=tuple(map(clean, page.text)),
                value=value,
                classes=tuple(map(clean, page.classes)),
                attributes=tuple(map(clean, page.attributes)),
            )

        return [
            replace(
                one.step,
                page=page_of(one),
                text=secrets.get(one.step.text, one.step.text) if one.is_password else clean(one.step.text),
            )
            for one in recorded
        ]

    def _reference(self, password: str, goal: Goal, values: Mapping[str, str]) -> str:
        if goal.find(password)[0] != NO_SPAN:
            return password
        for name, value in values.items():
            if value == password and name not in DRAWN:
                return f"{{{name}}}"
        if password not in self._variables:
            used, number = set(self._variables.values()), 1
            while (name := f"{VARIABLE}_{number}" if number > 1 else VARIABLE) in used:
                number += 1
            self._variables[password] = name
            self.unset.append(name)
        return f"{{env:{self._variables[password]}}}"


def _as_read(text: str) -> str:
    """A value as a page is read: white space collapsed, cut off."""
    return " ".join(text.split())[:LONGEST]
