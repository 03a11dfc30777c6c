"""The page of `giirl feedback` as HTML. All text, also that of web pages, is escaped by the template."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from giirl.feedback.selector import Candidate
from giirl.feedback.stage import Take
from giirl.report.element_rewards import Frame, describe_action, scale_of
from giirl.report.overlay import Overlay, draw_overlay
from giirl.report.render import data_url, render
from giirl_core.config import Config
from giirl_core.types import Trajectory

REFRESH_S = 1  # of pages that wait for something


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """What a person has entered and not sent yet, and what is wrong with it."""

    step: int = 0  # number of the marked step, from 1; 0 if none is
    right_for: str = ""
    error: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepView:
    """One step of an episode, ready for the template."""

    number: int  # from 1
    screenshot: str  # data URL of the PNG, "" without a screenshot
    overlay: Overlay
    doubt: int  # %


class Pages:
    """Renders the page of a run in each of its states."""

    def __init__(self, config: Config, name: str) -> None:
        self._scale, self._name = scale_of(config), name

    def ask(self, window: str, candidate: Candidate, said: Said, answers: int, last: str) -> str:
        """Ask about an episode. `last` is the key of the answer before, which can be changed."""
        steps = [
            self._step(number, frame, one)
            for number, (frame, one) in enumerate(zip(candidate.view.frames, candidate.doubts, strict=True), start=1)
        ]
        return self._render("ask", window, candidate, said=said, steps=steps, answers=answers, last=last)

    def show(self, window: str, take: Take) -> str:
        """While a person shows the right way, and once it is shown."""
        steps = describe_steps(take.shown) if take.shown is not None else []
        refresh = REFRESH_S if take.under_way else 0
        return self._render("show", window, take.candidate, take=take, steps=steps, refresh=refresh)

    def wait(self, window: str, answers: int) -> str:
        """While the next episodes are played."""
        return self._render("wait", window, None, answers=answers, refresh=REFRESH_S)

    def _render(self, state: str, window: str, candidate: Candidate | None, **content: Any) -> str:
        view = candidate.view if candidate is not None else None
        return render(
            "feedback.html",
            **{"refresh": 0, **content},
            title=f"{self._name}: feedback",
            state=state,
            window=window,
            key=candidate.key if candidate is not None else "",
            task=view.task if view is not None else "",
            instruction=view.frames[0].own.goal.utterance if view is not None else "",
        )

    def _step(self, number: int, frame: Frame, doubt: float) -> StepView:
        """A step with the policy's action. The rewards are left out: they would suggest an answer."""
        return StepView(
            number=number,
            screenshot=data_url(frame.screenshot) if frame.screenshot is not None else "",
            overlay=draw_overlay(frame.page, replace(frame.own, best=()), self._scale),
            doubt=round(100 * doubt),
        )


def describe_steps(trajectory: Trajectory) -> list[str]:
    """The actions of a trajectory in words."""
    return [
        describe_action(page, trajectory.goal, action)
        for page, action in zip(trajectory.pages, trajectory.actions, strict=True)
    ]
