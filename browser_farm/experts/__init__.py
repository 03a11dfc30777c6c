"""Scripted players that are right every time: they make demonstrations and show that the browser works.

Each is a function from what a policy sees to an action that a policy could take, and remembers nothing.
"""

from browser_farm.experts import buttons, dates, drags, forms, games, lists, mail, posts, shapes  # noqa: F401  (each enters its experts)
from browser_farm.experts.page_view import EXPERTS, NoAction, expert

__all__ = ["EXPERTS", "NoAction", "expert"]
