"""Does changing only the goal change the reward? The learned reward of every button, before and after a swap."""

from __future__ import annotations

from typing import Any

import numpy as np

from actors.browser import open_browser
from giirl.analysis.swaps import renamed
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.nets.reward import RewardModel, build_reward
from giirl_core.progress import Display
from giirl_core.types import Action, EpisodeSpec, Goal, Page, Purpose, Verb, Weights, page_seed

BARREN_PAGES = 200  # without a single one that can be asked about


def goal_swap(
    config: Config, reward: Weights, task: str, pages: int, metrics: Metrics, display: Display
) -> dict[str, Any]:
    """How often the reward ranks the goal's own button first, and after naming another, that one.

    Pages are fresh, and have at least two buttons that read differently; which other one is named is drawn by
    the page's seed. A tie counts as wrong. Buttons that read alike are one.
    """
    model = build_reward(config, reward)
    browser = open_browser(config, metrics)
    own = swapped = seen = 0
    try:
        with display.job("toggling goals", pages) as job:
            index = 0
            while seen < pages:
                batch = {
                    tab: EpisodeSpec(task=task, seed=page_seed(Purpose.INSPECT, config.seed, index + tab))
                    for tab in range(browser.tabs)
                }
                index += browser.tabs
                if index > BARREN_PAGES and not seen:
                    raise ValueError(f"{task} has no page of {index} with two buttons and one named in its goal")
                for shown in browser.reset(batch).values():
                    found = renamed(shown, "button")
                    if found is None or seen == pages:
                        continue
                    own += _best(model, shown.page, shown.goal) == found.wanted
                    swapped += _best(model, shown.page, found.goal) == found.other
                    seen += 1
                    job.advance()
    finally:
        browser.close()
    return {"own_goal_top1": own / pages, "swapped_goal_top1": swapped / pages, "pages": pages, "task": task}


def _best(model: RewardModel, page: Page, goal: Goal) -> str:
    """The label of the button whose click earns the most; "" when two that read differently tie."""
    buttons = [row for row, tag in enumerate(page.tag) if tag == "button"]
    clicks = [Action(verb=Verb.CLICK, element=row) for row in buttons]
    rewards = model.score_pairs([page] * len(clicks), clicks, [goal] * len(clicks)).numpy()
    top = {page.text[buttons[i]] for i in np.flatnonzero(rewards == rewards.max())}
    return top.pop() if len(top) == 1 else ""
