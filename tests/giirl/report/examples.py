"""Pages, scored pages and episodes for the tests of the report; some of them contain hostile text."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from giirl.report.element_rewards import EpisodeView, Frame, Scale, ScoredAction, ScoredPage
from giirl_core.types import Action, Goal, Outcome, Page, Verb

SCALE = Scale(low=-5.0, middle=0.0, high=5.0)
HOSTILE = "</text></svg><script>document.title='owned'</script><img src=x onerror=alert(1)> \"'&lt;"
GOAL = Goal('Click on the "Ok" button.')


def page(*rows: tuple[str, str, tuple[float, float, float, float]]) -> Page:
    """A page from rows of tag, text and (left, top, width, height)."""
    count = len(rows)
    return Page(
        tag=tuple(tag for tag, _, _ in rows),
        text=tuple(text for _, text, _ in rows),
        value=("",) * count,
        classes=("",) * count,
        ref=np.arange(1, count + 1, dtype=np.int32),
        parent=np.full(count, -1, dtype=np.int16),
        box=np.array([box for _, _, box in rows], dtype=np.float32).reshape(count, 4),
        focused=np.zeros(count, dtype=np.bool_),
        tampered=np.zeros(count, dtype=np.bool_),
    )


TWO = page(("button", "Ok", (10, 60, 40, 20)), ("button", "Cancel", (10, 90, 60, 20)))


def scored(*rewards: float, goal: Goal = GOAL, chosen: int = 0) -> ScoredPage:
    """Clicks on the first rows have these rewards, and the policy clicks on row `chosen`."""
    best = tuple(
        ScoredAction(action=Action(verb=Verb.CLICK, element=row), reward=reward) for row, reward in enumerate(rewards)
    )
    return ScoredPage(goal=goal, policy_action=Action(verb=Verb.CLICK, element=chosen), best=best)


def strip(on: Page = TWO, *, task: str = "click-button", screenshot: bytes | None = None) -> EpisodeView:
    """An episode of one step, under two instructions."""
    other = scored(-4.0, 4.5, goal=Goal('Click on the "Cancel" button.'), chosen=1)
    frame = Frame(page=on, screenshot=screenshot, own=scored(4.8, -3.2), other=other)
    return EpisodeView(task=task, seed=77, frames=(frame,), outcome=Outcome(raw_reward=1.0, ended=True))


def hostile_strip() -> EpisodeView:
    """An episode whose page, instruction, typed text and error contain HTML."""
    bad = Goal(f"Enter {HOSTILE} and go.")
    hostile = page(("input_text", "", (10, 60, 40, 20)), ("button", HOSTILE, (10, 90, 120, 20)))
    typing = Action(verb=Verb.TYPE, element=0, start=0, end=len(bad.tokens) - 1)
    own = replace(scored(1.0, 2.0, goal=bad), policy_action=typing)
    frame = Frame(page=hostile, screenshot=None, own=own, other=scored(-1.0, -2.0, goal=bad, chosen=1))
    return EpisodeView(task="click-button", seed=1, frames=(frame,), outcome=None, error=HOSTILE)
