"""Experts for the email-inbox tasks: star, delete, reply, forward."""

from __future__ import annotations

import re

from browser_farm.experts.page_view import PageView, expert_for
from giirl_core.types import Action

NAME = r"([A-Z][\w-]+(?: [A-Z][a-z]+)?)"
RECIPIENT = (  # recipient of a mail to forward, in instructions written by people
    rf"(?:[Ss]end|[Ff]orward|[Gg]ive)(?: to)? {NAME} [A-Z][\w-]+'s",
    rf"(?:\bto:?|\bfor|sure|put|want|'s email) {NAME}\b(?!['-]| the message| sent)",
    rf"\b(?:in|to) {NAME}'s",
    rf"(?:[Ss]end|[Ff]orward|[Gg]ive|[Ss]how|[Ll]et|email) {NAME} (?:the|a|all|any|that|my|email|receive)",
    rf"^{NAME} (?:wants|is waiting|must|needs|would|should)",
)
DELETE = r"(?i)delete|get rid|don't want|trash|remove|erase|garbage|throw|out of my|recycling"
STAR = r"(?i)important|star\b|flag|mark"


@expert_for(
    "email-inbox",
    "email-inbox-delete",
    "email-inbox-forward",
    "email-inbox-important",
    "email-inbox-noscroll",
    "email-inbox-reply",
    "email-inbox-star-reply",
)
def follow_the_template(view: PageView) -> Action:
    sender = view.extract(r"email by (.+?) and (?:click|reply|forward)")
    if "trash" in view.instruction or "star icon" in view.instruction:
        return _click_the_icon(view, sender, "trash" if "trash" in view.instruction else "star")
    if "reply" in view.instruction:
        return _write(view, sender, "reply", view.quoted()[0])
    return _write(view, sender, "forward", view.extract(r"forward that email to (.+)\.$"))


@expert_for("email-inbox-nl-turk", "email-inbox-forward-nl", "email-inbox-forward-nl-turk")
def follow_free_text(view: PageView) -> Action:
    """Instructions written by people. A few name sender and recipient the wrong way round; those episodes fail."""
    text = view.instruction
    reply, delete, star = '"' in text, re.search(DELETE, text), re.search(STAR, text)
    found = (re.search(pattern, text) for pattern in RECIPIENT)
    recipient = "" if reply or delete or star else next(match[1] for match in found if match)
    senders = {view.page.text[row] for row in view.rows(css_class="email-sender")} - {recipient}
    sender = max((name for name in senders if re.search(rf"\b{re.escape(name)}", text)), key=len, default="")
    if reply:
        return _write(view, sender, "reply", view.extract(r'"+(.*?)\s?"+'))
    if delete or star:
        return _click_the_icon(view, sender, "trash" if delete else "star")
    return _write(view, sender, "forward", recipient)


def _click_the_icon(view: PageView, sender: str, icon: str) -> Action:
    thread = view.ancestor(view.row(text=sender, css_class="email-sender"), css_class="email-thread")
    return view.click(view.row("span", css_class=icon, inside=thread))


def _write(view: PageView, sender: str, how: str, text: str) -> Action:
    """Open the email, click Reply or Forward, fill in the text, send. `how` is "reply" or "forward"."""
    if view.rows(css_class="email-thread"):
        return view.click(view.row(text=sender, css_class="email-sender"))
    if view.rows(css_class=f"email-{how}"):
        return view.click(view.first_leaf(view.row(css_class=f"email-{how}")))
    field = view.row("textarea") if how == "reply" else view.row("input_text", css_class="forward-sender")
    return view.fill({field: text}) or view.click(_send(view))


def _send(view: PageView) -> int:
    """The send icon: the rightmost icon of the top bar."""
    icons = [row for row in view.rows("span") if view.page.leaf[row] and not view.page.text[row]]
    return max(icons, key=lambda row: float(view.page.box[row, 0]))
