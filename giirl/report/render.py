"""Pages for people: one file of HTML each, with everything in it, and every text of a web page shown as text."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from giirl.report import charts
from giirl.report.element_rewards import (
    EpisodeView,
    Frame,
    Scale,
    ScoredAction,
    ScoredPage,
    element_name,
    ranked,
    shortened,
)
from giirl.report.overlay import MOST_LABELS, Overlay, draw_shot, number
from giirl_core.types import Goal, Verb

OWN, OTHER = "its own instruction", "another instruction"


@dataclass(frozen=True, slots=True, kw_only=True)
class SideView:
    """One step under one of the two instructions."""

    whose: str
    shot: Overlay
    does: str
    alt: str


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameView:
    """One step."""

    title: str
    picture: str  # data: address of the PNG, "" where there is none
    halves: tuple[SideView, ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]  # element, its reward under each instruction


@dataclass(frozen=True, slots=True, kw_only=True)
class StripView:
    """One episode."""

    task: str
    seed: int
    outcome: str
    outcome_class: str
    frames: tuple[FrameView, ...]


def render(template: str, **content: Any) -> str:
    """A whole page. Nothing in `content` is taken for HTML, whatever it holds."""
    environment = Environment(
        loader=PackageLoader("giirl.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    sizes = {"width": charts.WIDTH, "height": charts.HEIGHT, "left": charts.LEFT, "right": charts.RIGHT}
    return environment.get_template(template).render(**sizes, **content) + "\n"


def data_address(png: bytes) -> str:
    """A picture as the page carries it."""
    return "data:image/png;base64," + base64.b64encode(png).decode()


def scale_view(scale: Scale) -> dict[str, str]:
    """The numbers under the legend."""
    ends = {"low": scale.low, "middle": scale.middle, "high": scale.high}
    return {name: number(reward) for name, reward in ends.items()} | {"most": str(MOST_LABELS)}


def strip_view(strip: EpisodeView, scale: Scale) -> StripView:
    """An episode ready to be drawn."""
    words, kind = _outcome(strip)
    frames = tuple(_frame(strip.task, step, frame, scale) for step, frame in enumerate(strip.frames, 1))
    return StripView(task=strip.task, seed=strip.seed, outcome=words, outcome_class=kind, frames=frames)


def _outcome(strip: EpisodeView) -> tuple[str, str]:
    if strip.trouble:
        return f"broke off: {strip.trouble}", "lost"
    if strip.outcome is None:
        return "", ""
    if strip.outcome.success:
        return "succeeded", "won"
    how = f"the page pays {strip.outcome.raw_reward:g}" if strip.outcome.ended else "the step limit came first"
    return f"failed: {how}", "lost"


def _frame(task: str, step: int, frame: Frame, scale: Scale) -> FrameView:
    judged = {OWN: frame.own} | ({OTHER: frame.other} if frame.other is not None else {})
    return FrameView(
        title=f"Step {step}",
        picture=data_address(frame.picture) if frame.picture is not None else "",
        halves=tuple(_half(f"{task}, step {step}", frame, whose, one, scale) for whose, one in judged.items()),
        rows=_rows(frame, list(judged.values())),
    )


def _half(where: str, frame: Frame, whose: str, judged: ScoredPage, scale: Scale) -> SideView:
    shot = draw_shot(frame.page, judged, scale)
    verb = "The policy takes" if whose == OWN else "The policy would take"
    return SideView(
        whose=f"Under {whose}",
        shot=shot,
        does=f"{verb}: {shot.does}",
        alt=f"The page of {where}, under {whose}: {judged.goal.utterance} {shot.says}",
    )


def _cell(one: ScoredAction, goal: Goal) -> str:
    """A reward, and the words that earn it where typing them does."""
    words = f"“{shortened(one.action.text(goal))}” " if one.action.verb is Verb.TYPE else ""
    return words + number(one.reward)


def _rows(frame: Frame, judged: Sequence[ScoredPage]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    columns = [{one.action.element: _cell(one, each.goal) for one in each.best} for each in judged]
    rows = [one.action.element for one in ranked(frame.own.best)]
    return tuple((element_name(frame.page, row), tuple(column[row] for column in columns)) for row in rows)
