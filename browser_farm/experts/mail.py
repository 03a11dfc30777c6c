"""The inbox and its many forms: star, delete, reply, forward."""

from __future__ import annotations

from browser_farm.experts.sight import Sight, plays
from giirl.spec import Action


@plays(
    "email-inbox",
    "email-inbox-delete",
    "email-inbox-forward",
    "email-inbox-important",
    "email-inbox-noscroll",
    "email-inbox-reply",
    "email-inbox-star-reply",
)
def do_what_is_asked(see: Sight) -> Action:
    sender = see.words(r"email by (.+?) and (?:click|reply|forward)")
    if "trash" in see.said or "star icon" in see.said:
        return _click_the_icon(see, sender, "trash" if "trash" in see.said else "star")
    if "reply" in see.said:
        return _write(see, sender, "reply", see.quoted()[0])
    return _write(see, sender, "forward", see.words(r"forward that email to (.+)\.$"))


def _thread(see: Sight, sender: str) -> int:
    return see.above(see.row(text=sender, kind="email-sender"), kind="email-thread")


def _click_the_icon(see: Sight, sender: str, icon: str) -> Action:
    return see.click(see.row("span", kind=icon, inside=_thread(see, sender)))


def _write(see: Sight, sender: str, how: str, text: str) -> Action:
    """Open the email, press Reply or Forward, fill in, send."""
    if see.rows(kind="email-thread"):
        return see.click(see.row(text=sender, kind="email-sender"))
    if see.rows(kind=f"email-{how}"):
        return see.click(see.leaf(see.row(kind=f"email-{how}")))
    field = see.row("textarea") if how == "reply" else see.row("input_text", kind="forward-sender")
    return see.fill({field: text}) or see.click(_send(see))


def _send(see: Sight) -> int:
    """The icon on the right of the bar on top."""
    icons = [row for row in see.rows("span") if see.page.leaf[row] and not see.page.text[row]]
    return max(icons, key=lambda row: float(see.page.box[row, 0]))
