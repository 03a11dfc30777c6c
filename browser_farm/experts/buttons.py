"""Pages where one thing has to be found and clicked: buttons, links, tabs, sections, trees."""

from __future__ import annotations

from browser_farm.experts.page_view import ORDINAL, PageView, expert_for
from giirl_core.types import Action

GROWN_PX = 2  # the labels of a closed pie lie on one point


@expert_for("click-test")
def click_the_button(see: PageView) -> Action:
    return see.click(see.row("button"))


@expert_for("click-test-2", "click-test-transfer")
def click_the_named_button(see: PageView) -> Action:
    return see.press_button(see.words(r"button (\w+)\."))


@expert_for("click-button", "unicode-test")
def click_the_quoted_button(see: PageView) -> Action:
    return see.press_button(see.quoted()[0])


@expert_for("click-button-sequence")
def click_one_then_two(see: PageView) -> Action:
    first = see.row("button", "ONE")
    return see.click(first) if not see.page.tampered[first] else see.press_button("TWO")


@expert_for("click-dialog")
def close_the_dialog(see: PageView) -> Action:
    return see.click(see.row(kind="ui-icon-closethick"))


@expert_for("click-dialog-2")
def click_in_the_dialog(see: PageView) -> Action:
    label = see.quoted()[0]
    return close_the_dialog(see) if label == "x" else see.press_button(label)


@expert_for("click-link")
def click_the_link(see: PageView) -> Action:
    return see.click(see.row("span", see.quoted()[0], "alink"))


@expert_for("click-tab")
def open_the_tab(see: PageView) -> Action:
    return see.click(see.row("a", see.words(r"on (Tab #\d+)")))


@expert_for("click-tab-2", "click-tab-2-easy", "click-tab-2-medium", "click-tab-2-hard")
def find_the_link_behind_tabs(see: PageView) -> Action:
    links = see.rows("span", see.quoted()[0], "alink")
    if links:
        return see.click(links[0])
    tabs = see.rows("li", kind="ui-tabs-tab")
    here = next(i for i, tab in enumerate(tabs) if see.has(tab, "ui-tabs-active"))
    return see.click(see.leaf(tabs[here + 1]))


@expert_for("click-collapsible", "click-collapsible-nodelay")
def expand_and_submit(see: PageView) -> Action:
    header = see.row("h3")
    if see.has(header, "ui-accordion-header-active"):
        return see.press_button("Submit")
    return see.click(see.leaf(header))


@expert_for("click-collapsible-2", "click-collapsible-2-nodelay")
def find_the_link_in_sections(see: PageView) -> Action:
    links = see.rows("span", see.quoted()[0], "alink")
    if links:
        return see.click(links[0])
    sections = see.rows("h3")
    opened = [i for i, section in enumerate(sections) if see.has(section, "ui-accordion-header-active")]
    return see.click(see.leaf(sections[opened[0] + 1 if opened else 0]))


@expert_for("navigate-tree")
def find_the_file(see: PageView) -> Action:
    found = see.rows("span", see.quoted()[0])
    if found:
        return see.click(found[0])
    closed = [see.above(row, "li") for row in see.rows("span", kind="folder")]
    folder = next(row for row in closed if see.has(row, "expandable"))
    return see.click(see.row("span", kind="folder", inside=folder))


@expert_for("focus-text")
def focus_the_field(see: PageView) -> Action:
    return see.click(see.row("input_text"))


@expert_for("focus-text-2")
def focus_the_nth_field(see: PageView) -> Action:
    return see.click(see.rows("input_text")[int(see.words(ORDINAL)) - 1])


@expert_for("click-menu")
def walk_the_menu(see: PageView) -> Action:
    """Rest the mouse on an entry until what is below it opens, click the last one."""
    path = see.words(r"Select (.+)$").split(">")
    entries = [row for name in path for row in see.rows(text=name)]
    last = entries[-1]
    if len(entries) == len(path):
        return see.click(last)
    return see.hover(last)


@expert_for("click-widget")
def click_a_kind_of_widget(see: PageView) -> Action:
    kind = see.quoted()[0]
    return see.click(see.row(kind if kind in ("button", "textarea") else f"input_{kind}"))


@expert_for("click-pie", "click-pie-nodelay")
def open_the_pie(see: PageView) -> Action:
    label, opened = see.row("tspan", see.quoted()[0]), see.rows("tspan", "+")
    return see.click(label if see.page.box[label, 3] > GROWN_PX else opened[0] if opened else label)
