"""Pages, judgements and strips that the tests of the report are made of; some of them mean harm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from giirl.report.element_rewards import EpisodeView, Frame, Scale, ScoredAction, ScoredPage
from giirl_core.types import Action, Goal, Outcome, Page, Verb

SCALE = Scale(low=-5.0, middle=0.0, high=5.0)
HOSTILE = "</text></svg><script>document.title='owned'</script><img src=x onerror=alert(1)> \"'&lt;"
GOAL = Goal('Click on the "Ok" button.')


def page(*rows: tuple[str, str, tuple[float, float, float, float]]) -> Page:
    """Rows of tag, text, and left, top, width, height."""
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


def judged(*rewards: float, goal: Goal = GOAL, chosen: int = 0) -> ScoredPage:
    """Clicks on the first rows earn these."""
    best = tuple(
        ScoredAction(action=Action(verb=Verb.CLICK, element=row), reward=reward) for row, reward in enumerate(rewards)
    )
    return ScoredPage(goal=goal, choice=Action(verb=Verb.CLICK, element=chosen), best=best)


def strip(shown: Page = TWO, *, task: str = "click-button", picture: bytes | None = None) -> EpisodeView:
    """One step, under two instructions."""
    other = judged(-4.0, 4.5, goal=Goal('Click on the "Cancel" button.'), chosen=1)
    frame = Frame(page=shown, picture=picture, own=judged(4.8, -3.2), other=other)
    return EpisodeView(task=task, seed=77, frames=(frame,), outcome=Outcome(raw_reward=1.0, ended=True))


def hostile_strip() -> EpisodeView:
    """A page, its instruction and what is typed into it try to become part of the report."""
    bad = Goal(f"Enter {HOSTILE} and go.")
    shown = page(("input_text", "", (10, 60, 40, 20)), ("button", HOSTILE, (10, 90, 120, 20)))
    typing = Action(verb=Verb.TYPE, element=0, start=0, end=len(bad.tokens) - 1)
    own = replace(judged(1.0, 2.0, goal=bad), choice=typing)
    frame = Frame(page=shown, picture=None, own=own, other=judged(-1.0, -2.0, goal=bad, chosen=1))
    return EpisodeView(task="click-button", seed=1, frames=(frame,), outcome=None, trouble=HOSTILE)
