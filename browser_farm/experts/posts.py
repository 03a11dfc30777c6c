"""Experts for the social-media tasks: the buttons below posts."""

from __future__ import annotations

import re

from browser_farm.experts.page_view import PageView, expert_for
from giirl_core.types import Action


def _posts(view: PageView, user: str) -> list[int]:
    """The posts of a user."""
    return [view.ancestor(row, css_class="media") for row in view.rows("span", user, "username")]


@expert_for("social-media")
def press_below_the_post(view: PageView) -> Action:
    user, label = view.extract(r"user (@[^\s,]+),"), view.quoted()[0]
    post = _posts(view, user)[0]
    if label in ("Reply", "Retweet", "Like"):
        return view.click(view.row("span", css_class=label.lower(), inside=post))
    entries = [row for row in view.rows("li", inside=post) if view.all_text(row).startswith(label)]
    return view.click(entries[0] if entries else view.row("span", css_class="more", inside=post))


@expert_for("social-media-all", "social-media-some")
def press_below_many_posts(view: PageView) -> Action:
    label, user = view.quoted()[0].lower(), view.extract(r"by (@\S+) and then")
    buttons = [view.row("span", css_class=label, inside=post) for post in _posts(view, user)]
    amount = re.search(r"on (\d+) post", view.instruction)
    wanted = buttons if amount is None else buttons[: int(amount[1])]
    for button in wanted:
        if not view.has_class(button, "active"):
            return view.click(button)
    return view.click_button("Submit")
