"""Experts for tasks with one target to find and click: buttons, links, tabs, sections, trees."""

from __future__ import annotations

from browser_farm.experts.page_view import ORDINAL, PageView, expert_for
from giirl_core.types import Action

OPEN_PX = 2  # the labels of a closed pie menu are less high


@expert_for("click-test")
def click_the_button(view: PageView) -> Action:
    return view.click(view.row("button"))


@expert_for("click-test-2", "click-test-transfer")
def click_the_named_button(view: PageView) -> Action:
    return view.click_button(view.extract(r"button (\w+)\."))


@expert_for("click-button", "unicode-test")
def click_the_quoted_button(view: PageView) -> Action:
    return view.click_button(view.quoted()[0])


@expert_for("click-button-sequence")
def click_one_then_two(view: PageView) -> Action:
    first = view.row("button", "ONE")
    return view.click(first) if not view.page.tampered[first] else view.click_button("TWO")


@expert_for("click-dialog")
def close_the_dialog(view: PageView) -> Action:
    return view.click(view.row(css_class="ui-icon-closethick"))


@expert_for("click-dialog-2")
def click_in_the_dialog(view: PageView) -> Action:
    label = view.quoted()[0]
    return close_the_dialog(view) if label == "x" else view.click_button(label)


@expert_for("click-link")
def click_the_link(view: PageView) -> Action:
    return view.click(view.row("span", view.quoted()[0], "alink"))


@expert_for("click-tab")
def open_the_tab(view: PageView) -> Action:
    return view.click(view.row("a", view.extract(r"on (Tab #\d+)")))


@expert_for("click-tab-2", "click-tab-2-easy", "click-tab-2-medium", "click-tab-2-hard")
def find_the_link_behind_tabs(view: PageView) -> Action:
    links = view.rows("span", view.quoted()[0], "alink")
    if links:
        return view.click(links[0])
    tabs = view.rows("li", css_class="ui-tabs-tab")
    active = next(i for i, tab in enumerate(tabs) if view.has_class(tab, "ui-tabs-active"))
    return view.click(view.first_leaf(tabs[active + 1]))


@expert_for("click-collapsible", "click-collapsible-nodelay")
def expand_and_submit(view: PageView) -> Action:
    header = view.row("h3")
    if view.has_class(header, "ui-accordion-header-active"):
        return view.click_button("Submit")
    return view.click(view.first_leaf(header))


@expert_for("click-collapsible-2", "click-collapsible-2-nodelay")
def find_the_link_in_sections(view: PageView) -> Action:
    links = view.rows("span", view.quoted()[0], "alink")
    if links:
        return view.click(links[0])
    sections = view.rows("h3")
    opened = [i for i, section in enumerate(sections) if view.has_class(section, "ui-accordion-header-active")]
    return view.click(view.first_leaf(sections[opened[0] + 1 if opened else 0]))


@expert_for("navigate-tree")
def find_the_file(view: PageView) -> Action:
    found = view.rows("span", view.quoted()[0])
    if found:
        return view.click(found[0])
    closed = [view.ancestor(row, "li") for row in view.rows("span", css_class="folder")]
    folder = next(row for row in closed if view.has_class(row, "expandable"))
    return view.click(view.row("span", css_class="folder", inside=folder))


@expert_for("focus-text")
def focus_the_field(view: PageView) -> Action:
    return view.click(view.row("input_text"))


@expert_for("focus-text-2")
def focus_the_nth_field(view: PageView) -> Action:
    return view.click(view.rows("input_text")[int(view.extract(ORDINAL)) - 1])


@expert_for("click-menu")
def walk_the_menu(view: PageView) -> Action:
    """Hover over the entries of the path to open their submenus, then click the last entry."""
    path = view.extract(r"Select (.+)$").split(">")
    entries = [row for name in path for row in view.rows(text=name)]
    last = entries[-1]
    if len(entries) == len(path):
        return view.click(last)
    return view.hover(last)


@expert_for("click-widget")
def click_the_widget(view: PageView) -> Action:
    widget = view.quoted()[0]
    return view.click(view.row(widget if widget in ("button", "textarea") else f"input_{widget}"))


@expert_for("click-pie", "click-pie-nodelay")
def open_the_pie(view: PageView) -> Action:
    label, opened = view.row("tspan", view.quoted()[0]), view.rows("tspan", "+")
    return view.click(label if view.page.box[label, 3] > OPEN_PX else opened[0] if opened else label)
