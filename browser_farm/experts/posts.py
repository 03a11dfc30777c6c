"""Posts of a social medium, and the buttons below them."""

from __future__ import annotations

import re

from browser_farm.experts.page_view import PageView, expert_for
from giirl_core.types import Action


def _posts(see: PageView, user: str) -> list[int]:
    return [see.above(row, kind="media") for row in see.rows("span", user, "username")]


@expert_for("social-media")
def press_below_the_post(see: PageView) -> Action:
    user, label = see.words(r"user (@[^\s,]+),"), see.quoted()[0]
    post = _posts(see, user)[0]
    if label in ("Reply", "Retweet", "Like"):
        return see.click(see.row("span", kind=label.lower(), inside=post))
    entries = [row for row in see.rows("li", inside=post) if see.reading(row).startswith(label)]
    return see.click(entries[0] if entries else see.row("span", kind="more", inside=post))


@expert_for("social-media-all", "social-media-some")
def press_below_many_posts(see: PageView) -> Action:
    label, user = see.quoted()[0].lower(), see.words(r"by (@\S+) and then")
    buttons = [see.row("span", kind=label, inside=post) for post in _posts(see, user)]
    amount = re.search(r"on (\d+) post", see.said)
    wanted = buttons if amount is None else buttons[: int(amount[1])]
    for button in wanted:
        if not see.has(button, "active"):
            return see.click(button)
    return see.press_button("Submit")
