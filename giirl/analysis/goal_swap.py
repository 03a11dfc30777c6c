"""Whether the reward follows the goal: the learned reward of every button before and after the goal is swapped."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import numpy as np

from actors.browser import open_browser
from giirl.analysis.swaps import swap_goal
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.nets.reward import RewardModel, build_reward
from giirl_core.progress import Display
from giirl_core.types import Action, EpisodeSpec, Goal, Page, Purpose, Verb, page_seed
from giirl_core.weights import Weights

MAX_UNUSABLE_PAGES = 200  # from the start, before the task is given up


def goal_swap(
    config: Config, reward: Weights, task: str, pages: int, metrics: Metrics, display: Display
) -> dict[str, Any]:
    """The fraction of pages on which the reward ranks the button in the goal first, before and after a goal swap.

    The pages are fresh and have at least two buttons with different labels. The swapped goal names another button,
    chosen by the page's seed. A tie counts as wrong. Buttons with the same label count as one.
    """
    model = build_reward(config, reward)
    own = swapped = used = index = 0
    with closing(open_browser(config, metrics)) as browser, display.job("swapping goals", pages) as job:
        while used < pages:
            batch = {
                tab: EpisodeSpec(task=task, seed=page_seed(Purpose.INSPECT, config.seed, index + tab))
                for tab in range(browser.tabs)
            }
            index += browser.tabs
            if index > MAX_UNUSABLE_PAGES and not used:
                raise ValueError(f"{task} has no page of {index} with two buttons and one named in its goal")
            opened = browser.reset(batch)
            if not opened:
                raise RuntimeError(f"no page can be opened: {', '.join(browser.unopened.values())}")
            for observation in opened.values():
                swap = swap_goal(observation, "button")
                if swap is None or used == pages:
                    continue
                own += _best(model, observation.page, observation.goal) == swap.wanted
                swapped += _best(model, observation.page, swap.goal) == swap.other
                used += 1
                job.advance()
    return {"own_goal_top1": own / pages, "swapped_goal_top1": swapped / pages, "pages": pages, "task": task}


def _best(model: RewardModel, page: Page, goal: Goal) -> str:
    """The label of the button whose click has the highest reward; "" when two different labels tie."""
    buttons = [row for row, tag in enumerate(page.tag) if tag == "button"]
    clicks = [Action(verb=Verb.CLICK, element=row) for row in buttons]
    rewards = model.score_pairs([page] * len(clicks), clicks, [goal] * len(clicks)).numpy()
    top = {page.text[buttons[i]] for i in np.flatnonzero(rewards == rewards.max())}
    return top.pop() if len(top) == 1 else ""
