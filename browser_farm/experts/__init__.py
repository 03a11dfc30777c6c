"""Scripted experts for the MiniWoB tasks: they make demonstrations and test the browser.

Each is a stateless function from the observation that a policy gets to an action that a policy could take.
"""

from browser_farm.experts import buttons, dates, drags, forms, games, lists, mail, posts, shapes  # noqa: F401  (each module registers its experts)
from browser_farm.experts.page_view import EXPERTS, NoAction, expert

__all__ = ["EXPERTS", "NoAction", "expert"]
