"""The inbox and its many forms: star, delete, reply, forward."""

from __future__ import annotations

import re

from browser_farm.experts.page_view import PageView, expert_for
from giirl_core.types import Action

NAME = r"([A-Z][\w-]+(?: [A-Z][a-z]+)?)"
RECIPIENT = (  # of a mail to be forwarded, in people's own words
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
def do_what_is_asked(see: PageView) -> Action:
    sender = see.words(r"email by (.+?) and (?:click|reply|forward)")
    if "trash" in see.said or "star icon" in see.said:
        return _click_the_icon(see, sender, "trash" if "trash" in see.said else "star")
    if "reply" in see.said:
        return _write(see, sender, "reply", see.quoted()[0])
    return _write(see, sender, "forward", see.words(r"forward that email to (.+)\.$"))


@expert_for("email-inbox-nl-turk", "email-inbox-forward-nl", "email-inbox-forward-nl-turk")
def do_what_is_wished(see: PageView) -> Action:
    """People's own words. A few of them have sender and recipient the wrong way round; those are lost."""
    reply, delete, star = ('"' in see.said, re.search(DELETE, see.said), re.search(STAR, see.said))
    found = (re.search(pattern, see.said) for pattern in RECIPIENT)
    recipient = "" if reply or delete or star else next(match[1] for match in found if match)
    senders = {see.page.text[row] for row in see.rows(kind="email-sender")} - {recipient}
    sender = max((name for name in senders if re.search(rf"\b{re.escape(name)}", see.said)), key=len, default="")
    if reply:
        return _write(see, sender, "reply", see.words(r'"+(.*?)\s?"+'))
    if delete or star:
        return _click_the_icon(see, sender, "trash" if delete else "star")
    return _write(see, sender, "forward", recipient)


def _click_the_icon(see: PageView, sender: str, icon: str) -> Action:
    thread = see.above(see.row(text=sender, kind="email-sender"), kind="email-thread")
    return see.click(see.row("span", kind=icon, inside=thread))


def _write(see: PageView, sender: str, how: str, text: str) -> Action:
    """Open the email, press Reply or Forward, fill in, send."""
    if see.rows(kind="email-thread"):
        return see.click(see.row(text=sender, kind="email-sender"))
    if see.rows(kind=f"email-{how}"):
        return see.click(see.leaf(see.row(kind=f"email-{how}")))
    field = see.row("textarea") if how == "reply" else see.row("input_text", kind="forward-sender")
    return see.fill({field: text}) or see.click(_send(see))


def _send(see: PageView) -> int:
    """The icon on the right of the bar on top."""
    icons = [row for row in see.rows("span") if see.page.leaf[row] and not see.page.text[row]]
    return max(icons, key=lambda row: float(see.page.box[row, 0]))
