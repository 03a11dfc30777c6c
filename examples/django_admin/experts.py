"""Scripted experts of the five tasks: functions from what an agent sees of the admin to its next action."""

from __future__ import annotations

from browser_farm.experts.page_view import PageView
from giirl_core.types import Action


def add_user(view: PageView) -> Action:
    """Users, Add user, name and password; then the other names on the page that follows."""
    username, first, last, password = view.quoted()
    if view.rows("input_text", "First name:"):
        names = {view.row("input_text", "First name:"): first, view.row("input_text", "Last name:"): last}
        return view.fill(names) or save(view)
    if view.rows("input_text", "Username:"):
        passwords = {view.row("input_password", label): password for label in ("Password:", "Password confirmation:")}
        return view.fill({view.row("input_text", "Username:"): username, **passwords}) or save(view)
    return follow(view, "Add user", "Users")


def change_price(view: PageView) -> Action:
    """Products, the product, its price."""
    product, price = view.quoted()
    if view.rows("input_number", "Price:"):
        return view.fill({view.row("input_number", "Price:"): price}) or save(view)
    return follow(view, product, "Products")


def ship_order(view: PageView) -> Action:
    """Orders, a search for the number, the order, its status."""
    (order,) = view.quoted()
    if view.rows("option", "Shipped"):
        shipped = view.row("option", "Shipped")
        return save(view) if view.page.value[shipped] else view.click(shipped)
    if not view.rows("input_text", "Search"):
        return follow(view, "Orders")
    field = view.row("input_text", "Search")
    if view.page.value[field] != order:
        return view.type(field, order)
    if any(text.startswith("1 result") for text in view.page.text):
        return follow(view, order)
    return view.click(view.row("input_submit", "Search"))


def delete_comment(view: PageView) -> Action:
    """Comments, the comment, Delete, and once more when asked."""
    (author,) = view.quoted()
    for row in view.rows("input_submit"):
        if view.page.text[row].startswith("Yes"):
            return view.click(row)
    return follow(view, "Delete", author, "Comments")


def open_match(view: PageView) -> Action:
    """Orders, the filter, the order of the customer."""
    status, customer = view.quoted()
    is_filtered = any("Clear all filters" in text for text in view.page.text)
    return follow(view, customer if is_filtered else status, "Orders")


def follow(view: PageView, *texts: str) -> Action:
    """Click the first of these links that the page has."""
    for text in texts:
        if view.rows("a", text):
            return view.click(view.row("a", text))
    raise ValueError(f"the page has no link {' or '.join(texts)}")


def save(view: PageView) -> Action:
    """Click Save."""
    return view.click(view.row("input_submit", "Save"))
