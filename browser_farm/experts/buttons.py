"""Pages where one thing has to be found and clicked: buttons, links, tabs, sections, trees."""

from __future__ import annotations

from browser_farm.experts.page_view import ORDINAL, Sight, plays
from giirl_core.types import Action

GROWN_PX = 2  # the labels of a closed pie lie on one point


@plays("click-test")
def click_the_button(see: Sight) -> Action:
    return see.click(see.row("button"))


@plays("click-test-2", "click-test-transfer")
def click_the_named_button(see: Sight) -> Action:
    return see.press_button(see.words(r"button (\w+)\."))


@plays("click-button", "unicode-test")
def click_the_quoted_button(see: Sight) -> Action:
    return see.press_button(see.quoted()[0])


@plays("click-button-sequence")
def click_one_then_two(see: Sight) -> Action:
    first = see.row("button", "ONE")
    return see.click(first) if not see.page.tampered[first] else see.press_button("TWO")


@plays("click-dialog")
def close_the_dialog(see: Sight) -> Action:
    return see.click(see.row(kind="ui-icon-closethick"))


@plays("click-dialog-2")
def click_in_the_dialog(see: Sight) -> Action:
    label = see.quoted()[0]
    return close_the_dialog(see) if label == "x" else see.press_button(label)


@plays("click-link")
def click_the_link(see: Sight) -> Action:
    return see.click(see.row("span", see.quoted()[0], "alink"))


@plays("click-tab")
def open_the_tab(see: Sight) -> Action:
    return see.click(see.row("a", see.words(r"on (Tab #\d+)")))


@plays("click-tab-2", "click-tab-2-easy", "click-tab-2-medium", "click-tab-2-hard")
def find_the_link_behind_tabs(see: Sight) -> Action:
    links = see.rows("span", see.quoted()[0], "alink")
    if links:
        return see.click(links[0])
    tabs = see.rows("li", kind="ui-tabs-tab")
    here = next(i for i, tab in enumerate(tabs) if see.has(tab, "ui-tabs-active"))
    return see.click(see.leaf(tabs[here + 1]))


@plays("click-collapsible", "click-collapsible-nodelay")
def expand_and_submit(see: Sight) -> Action:
    header = see.row("h3")
    if see.has(header, "ui-accordion-header-active"):
        return see.press_button("Submit")
    return see.click(see.leaf(header))


@plays("click-collapsible-2", "click-collapsible-2-nodelay")
def find_the_link_in_sections(see: Sight) -> Action:
    links = see.rows("span", see.quoted()[0], "alink")
    if links:
        return see.click(links[0])
    sections = see.rows("h3")
    opened = [i for i, section in enumerate(sections) if see.has(section, "ui-accordion-header-active")]
    return see.click(see.leaf(sections[opened[0] + 1 if opened else 0]))


@plays("navigate-tree")
def find_the_file(see: Sight) -> Action:
    found = see.rows("span", see.quoted()[0])
    if found:
        return see.click(found[0])
    closed = [see.above(row, "li") for row in see.rows("span", kind="folder")]
    folder = next(row for row in closed if see.has(row, "expandable"))
    return see.click(see.row("span", kind="folder", inside=folder))


@plays("focus-text")
def focus_the_field(see: Sight) -> Action:
    return see.click(see.row("input_text"))


@plays("focus-text-2")
def focus_the_nth_field(see: Sight) -> Action:
    return see.click(see.rows("input_text")[int(see.words(ORDINAL)) - 1])


@plays("click-menu")
def walk_the_menu(see: Sight) -> Action:
    """Rest the mouse on an entry until what is below it opens, click the last one."""
    path = see.words(r"Select (.+)$").split(">")
    entries = [row for name in path for row in see.rows(text=name)]
    last = entries[-1]
    if len(entries) == len(path):
        return see.click(last)
    return see.hover(last)


@plays("click-widget")
def click_a_kind_of_widget(see: Sight) -> Action:
    kind = see.quoted()[0]
    return see.click(see.row(kind if kind in ("button", "textarea") else f"input_{kind}"))


@plays("click-pie", "click-pie-nodelay")
def open_the_pie(see: Sight) -> Action:
    label, opened = see.row("tspan", see.quoted()[0]), see.rows("tspan", "+")
    return see.click(label if see.page.box[label, 3] > GROWN_PX else opened[0] if opened else label)
