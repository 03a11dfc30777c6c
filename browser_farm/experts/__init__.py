"""Scripted experts for MiniWoB tasks: they generate demonstrations and test the browser farm.

Each expert is a stateless function from an observation to an action, the same that policies get and return.
"""

from browser_farm.experts import buttons, dates, drags, forms, games, lists, mail, posts, shapes  # noqa: F401  (each registers its experts)
from browser_farm.experts.page_view import EXPERTS, NoAction, expert

__all__ = ["EXPERTS", "NoAction", "expert"]
