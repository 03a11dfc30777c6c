"""Render reports as self-contained HTML files. All content is escaped, including text from web pages."""

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
    by_reward,
    describe_action,
    element_name,
    truncate,
)
from giirl.report.overlay import MAX_LABELS, Overlay, draw_overlay, format_reward
from giirl_core.types import Goal

OWN, OTHER = "Own instruction", "Swapped instruction"


@dataclass(frozen=True, slots=True, kw_only=True)
class SideView:
    """One step under one of the two instructions."""

    heading: str
    overlay: Overlay
    action: str
    alt: str  # for screen readers


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameView:
    """One step of an episode."""

    title: str
    screenshot: str  # data URL of the PNG, "" without a screenshot
    sides: tuple[SideView, ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]  # element, its reward under each instruction


@dataclass(frozen=True, slots=True, kw_only=True)
class StripView:
    """One episode as a film strip, ready for the template."""

    task: str
    seed: int
    outcome: str
    outcome_class: str
    cause: str
    frames: tuple[FrameView, ...]


def render(template: str, **content: Any) -> str:
    """Render a template with escaped `content`. A missing name is an error (StrictUndefined)."""
    environment = Environment(
        loader=PackageLoader("giirl.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    sizes = {"width": charts.WIDTH, "height": charts.HEIGHT, "left": charts.LEFT, "right": charts.RIGHT}
    return environment.get_template(template).render(**sizes, **content) + "\n"


def data_url(png: bytes) -> str:
    """A PNG as a data URL."""
    return "data:image/png;base64," + base64.b64encode(png).decode()


def scale_view(scale: Scale) -> dict[str, str]:
    """The formatted values that the legend shows."""
    ends = {"low": scale.low, "middle": scale.middle, "high": scale.high}
    return {name: format_reward(reward) for name, reward in ends.items()} | {"max_labels": str(MAX_LABELS)}


def strip_view(strip: EpisodeView, scale: Scale) -> StripView:
    """Prepare an episode for the template."""
    outcome, outcome_class = _outcome(strip)
    frames = tuple(_frame(strip.task, step, frame, scale) for step, frame in enumerate(strip.frames, 1))
    return StripView(
        task=strip.task,
        seed=strip.seed,
        outcome=outcome,
        outcome_class=outcome_class,
        cause=failure_cause(strip, scale),
        frames=frames,
    )


def failure_cause(strip: EpisodeView, scale: Scale) -> str:
    """What the learned reward says about a failed episode, "" where there is nothing to say.

    Either it knows better than the policy, at its first step with D < 1/2, or it knows no better.
    """
    steps = [(frame, frame.own.policy_action, frame.own.policy_reward) for frame in strip.frames]
    taken = [(frame, ScoredAction(action=a, reward=r)) for frame, a, r in steps if a is not None and r is not None]
    if strip.outcome is None or strip.outcome.success or not taken:
        return ""
    for step, (frame, one) in enumerate(taken, 1):
        if one.reward < scale.middle:
            rejected, best = _in_words(frame, one), frame.own.top
            if best is None or best.reward <= one.reward:
                return f"The reward rejects step {step}, {rejected}, and knows nothing better."
            return f"The reward rejects step {step}, {rejected}, and prefers {_in_words(frame, best)}."
    return "The reward accepts every step: it does not know what is wrong either."


def _in_words(frame: Frame, one: ScoredAction) -> str:
    return f"{describe_action(frame.page, frame.own.goal, one.action)} ({format_reward(one.reward)})"


def _outcome(strip: EpisodeView) -> tuple[str, str]:
    """The outcome as text, and its CSS class."""
    if strip.error:
        return f"not finished: {strip.error}", "lost"
    if strip.outcome is None:
        return "", ""
    if strip.outcome.success:
        return "succeeded", "won"
    reason = f"page reward {strip.outcome.raw_reward:g}" if strip.outcome.ended else "step limit reached"
    return f"failed: {reason}", "lost"


def _frame(task: str, step: int, frame: Frame, scale: Scale) -> FrameView:
    scored = {OWN: frame.own} | ({OTHER: frame.other} if frame.other is not None else {})
    return FrameView(
        title=f"Step {step}",
        screenshot=data_url(frame.screenshot) if frame.screenshot is not None else "",
        sides=tuple(_side(f"{task}, step {step}", frame, heading, one, scale) for heading, one in scored.items()),
        rows=_rows(frame, list(scored.values())),
    )


def _side(step: str, frame: Frame, heading: str, scored: ScoredPage, scale: Scale) -> SideView:
    overlay = draw_overlay(frame.page, scored, scale)
    prefix = "Policy action" if heading == OWN else "Policy action (not executed)"
    return SideView(
        heading=heading,
        overlay=overlay,
        action=f"{prefix}: {overlay.action}",
        alt=f"Page of {step}. {heading}: {scored.goal.utterance} {overlay.description}",
    )


def _cell(one: ScoredAction, goal: Goal) -> str:
    """A reward, preceded by the words or the key if the action types."""
    text = one.action.text(goal)
    return (f"“{truncate(text)}” " if text else "") + format_reward(one.reward)


def _rows(frame: Frame, scored: Sequence[ScoredPage]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    columns = [{one.action.element: _cell(one, side.goal) for one in side.best} for side in scored]
    rows = [one.action.element for one in by_reward(frame.own.best)]
    return tuple((element_name(frame.page, row), tuple(column[row] for column in columns)) for row in rows)
