"""Experts for tasks with typing: text fields, searches, log-ins, tables, arithmetic."""

from __future__ import annotations

import re
from collections.abc import Callable

from browser_farm.experts.page_view import ORDINAL, PageView, expert_for
from giirl_core.types import Action

COLOURS = {
    "aqua": "00ffff",
    "black": "000000",
    "blue": "0000ff",
    "gold": "ffd700",
    "gray": "808080",
    "green": "008000",
    "lime": "00ff00",
    "magenta": "ff00ff",
    "maroon": "800000",
    "navy": "000080",
    "olive": "808000",
    "orange": "ffa500",
    "pink": "ffc0cb",
    "purple": "800080",
    "red": "ff0000",
    "silver": "c0c0c0",
    "teal": "008080",
    "white": "ffffff",
    "yellow": "ffff00",
}


@expert_for("enter-text", "enter-text-dynamic", "enter-password")
def enter_the_quoted_text(view: PageView) -> Action:
    text = view.quoted()[0]
    fields = [*view.rows("input_text"), *view.rows("input_password")]
    return view.fill(dict.fromkeys(fields, text)) or view.click_button("Submit")


@expert_for("login-user", "login-user-popup")
def log_in(view: PageView) -> Action:
    name, password = view.quoted()
    if view.rows("button", "Cancel"):  # a pop-up window is open
        return view.click_button("Cancel")
    action = view.fill({view.row("input_text"): name, view.row("input_password"): password})
    return action or view.click(view.row("button"))


@expert_for("multi-layouts", "multi-orderings")
def search_for_a_movie(view: PageView) -> Action:
    fields: dict[int, str] = {}
    texts = [row for row in range(len(view.page)) if view.page.text[row]]
    for pattern, text in (
        ("Genre", view.extract(r"for (\w+) movie")),
        ("Director", view.extract(r"directed by (\w+)")),
        ("Year|Date", view.extract(r"year (\d+)")),
    ):
        label = next(row for row in texts if re.search(pattern, view.page.text[row]))
        fields[_field_of(view, label)] = text
    buttons = [row for row in texts if view.page.text[row] in ("Submit", "Search", "Go!")]
    return view.fill(fields) or view.click(max(buttons))


def _field_of(view: PageView, label: int) -> int:
    """The text field of the nearest ancestor of the label that has one."""
    ancestor = int(view.page.parent[label])
    while not view.rows("input_text", inside=ancestor):
        ancestor = int(view.page.parent[ancestor])
    return view.row("input_text", inside=ancestor)


@expert_for("search-engine")
def click_the_nth_result(view: PageView) -> Action:
    wanted, nth = view.quoted()[0], int(view.extract(ORDINAL)) - 1
    action = view.fill({view.row("input_text"): wanted})
    if action:
        return action
    titles = view.rows("a", css_class="search-title")
    if not titles:
        return view.click_button("Search")
    page, place = divmod(nth, 3)
    shown = view.all_text(view.row("li", css_class="active"))
    return view.click(titles[place] if shown == str(page + 1) else view.row("a", str(page + 1)))


@expert_for("form-sequence-2")
def check_and_enter(view: PageView) -> Action:
    radio, field = (int(nth) - 1 for nth in re.findall(ORDINAL, view.instruction))
    button = view.rows("input_radio")[radio]
    if view.page.value[button] != "checked":
        return view.click(button)
    return view.fill({view.rows("input_text")[field]: view.quoted()[0]}) or view.click_button("Submit")


@expert_for("enter-text-2")
def enter_in_case(view: PageView) -> Action:
    text = view.quoted()[0]
    text = text.upper() if "upper case" in view.instruction else text.lower()
    return view.fill({view.row("input_text"): text}) or view.click_button("Submit")


@expert_for("enter-date")
def enter_the_date(view: PageView) -> Action:
    field, date = view.row("input_date"), view.extract(r"Enter (\S+) as")
    month, day, year = date.split("/")
    return view.click_button("Submit") if view.page.value[field] == f"{year}-{month}-{day}" else view.type(field, date)


@expert_for("enter-time")
def enter_the_time(view: PageView) -> Action:
    field, time = view.row("input_time"), view.extract(r"(\d+:\d+ [AP]M)")
    hour, minute, half = re.split("[: ]", time)
    done = view.page.value[field] == f"{int(hour) % 12 + (12 if half == 'PM' else 0):02}:{minute}"
    return view.click_button("Submit") if done else view.type(field, time)


@expert_for("find-word")
def enter_the_nth_word(view: PageView) -> Action:
    word = view.all_text(view.row("p")).split()[int(view.extract(ORDINAL)) - 1].strip(",.")
    return view.fill({view.row("input_text"): word}) or view.click_button("Submit")


@expert_for("scroll-text")
def enter_the_last_word(view: PageView) -> Action:
    word = view.page.value[view.row("textarea")].split()[-1].strip(",.")
    return view.fill({view.row("input_text"): word}) or view.click_button("Submit")


@expert_for("copy-paste", "copy-paste-2")
def copy_the_text(view: PageView) -> Action:
    nth = re.search(ORDINAL, view.instruction)
    area = view.rows("textarea")[int(nth[1]) - 1 if nth else 0]
    return view.fill({view.row("input_text"): view.page.value[area]}) or view.click_button("Submit")


def _table(view: PageView) -> dict[str, str]:
    """The two-column table of the page: name -> value."""
    cells = [view.page.text[row] for row in view.rows("td")]
    return dict(zip(cells[::2], cells[1::2], strict=True))


@expert_for("read-table")
def enter_the_value(view: PageView) -> Action:
    value = _table(view)[view.extract(r"value of (.+) into")]
    return view.fill({view.row("input_text"): value}) or view.click_button("Submit")


@expert_for("read-table-2")
def enter_the_values(view: PageView) -> Action:
    table = _table(view)
    names = [view.page.text[row].rstrip(":") for row in view.rows("label")]
    wanted = {field: table[name] for field, name in zip(view.rows("input_text"), names, strict=True)}
    return view.fill(wanted) or view.click_button("Submit")


@expert_for("simple-arithmetic", "simple-algebra")
def solve(view: PageView) -> Action:
    """Solve `a + b =`, or an equation in x with two numbers."""
    problem = next(view.page.text[row] for row in view.rows("div") if "=" in view.page.text[row])
    left, sign, right, result = re.findall(r"(\S+) ([-+x*]) (\S+) =\s*(\S*)", problem)[0]
    if not result:
        answer = {"+": int.__add__, "-": int.__sub__, "x": int.__mul__, "*": int.__mul__}[sign](int(left), int(right))
    elif left == "x":
        answer = int(result) - int(right) if sign == "+" else int(result) + int(right)
    else:
        answer = int(result) - int(left) if sign == "+" else int(left) - int(result)
    return view.fill({view.row("input_text"): str(answer)}) or view.click_button("Submit")


@expert_for("visual-addition")
def count_the_blocks(view: PageView) -> Action:
    blocks = len(view.rows(css_class="addition-block"))
    return view.fill({view.row("input_text"): str(blocks)}) or view.click_button("Submit")


@expert_for("text-transform")
def read_the_letters(view: PageView) -> Action:
    text = "".join(view.page.text[row] for row in view.rows("span"))
    return view.fill({view.row("input_text"): text}) or view.click_button("Submit")


@expert_for("use-spinner")
def turn_the_spinner(view: PageView) -> Action:
    now, wanted = int(view.page.value[view.row("input_text")]), int(view.extract(r"Select (-?\d+) with"))
    if now == wanted:
        return view.click_button("Submit")
    return view.click(view.first_leaf(view.row("a", css_class="ui-spinner-up" if wanted > now else "ui-spinner-down")))


@expert_for("form-sequence-3")
def choose_then_press(view: PageView) -> Action:
    wanted = view.extract(r"Choose (.+) from the dropdown")
    if view.page.text[view.row("span", css_class="label")] == wanted:
        return view.click_button(view.quoted()[0])
    options = view.rows("li", wanted)
    return view.click(options[0] if options else view.row("span", css_class="label"))


@expert_for("use-colorwheel")
def enter_the_colour(view: PageView) -> Action:
    colour = COLOURS[view.extract(r"Select (\w+) with")]
    field = view.row("input_text")
    if view.page.value[field].lower() == colour:
        return view.click_button("Submit")
    return view.type(field, colour)


@expert_for("use-autocomplete", "use-autocomplete-nodelay")
def enter_an_item(view: PageView) -> Action:
    field = view.row("input_text")
    start, end = [*view.quoted(), ""][:2]
    value = view.page.value[field]
    if len(value) > len(start) and value.startswith(start) and value.endswith(end):
        return view.click_button("Submit")
    action = view.fill({field: start})
    return action or click_suggestion(view, lambda name: name.startswith(start) and name.endswith(end))


def click_suggestion(view: PageView, fits: Callable[[str], bool]) -> Action:
    """Click the first suggestion of an autocomplete list whose text fits."""
    suggested = view.rows("div", css_class="ui-menu-item-wrapper")
    return view.click(view.first_leaf(next(row for row in suggested if fits(view.all_text(row)))))


@expert_for("terminal")
def delete_a_file(view: PageView) -> Action:
    """Type ls, then rm with a file of the wanted extension; Enter after each command."""
    rows = view.rows("div")
    lines = [row for row in rows if view.has_class(row, "terminal-line") or view.has_class(row, "terminal-output")]
    texts = [view.all_text(row) for row in lines]
    listed = [i for i, text in enumerate(texts[:-1]) if text == "user$ ls"]
    command = f"rm {_file(view, texts[listed[0] + 1])}" if listed else "ls"
    field = view.row("input_text")
    typed = texts[-1].removeprefix("user$").removesuffix("█").strip()
    return view.press("Enter", field) if typed == command else view.type(field, command)


def _file(view: PageView, listing: str) -> str:
    """The first file of a listing with the extension that the instruction names, or without one."""
    ending = re.search(r"extension (\.\S+)$", view.instruction)
    return next(
        name
        for name in listing.split()
        if ("." not in name if ending is None else name.partition(".")[2] == ending[1][1:])
    )
