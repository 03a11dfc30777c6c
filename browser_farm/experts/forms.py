"""Pages where something is typed: fields, searches, log-ins, tables, sums."""

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
def enter_the_quoted_text(see: PageView) -> Action:
    text = see.quoted()[0]
    fields = [*see.rows("input_text"), *see.rows("input_password")]
    return see.fill(dict.fromkeys(fields, text)) or see.press_button("Submit")


@expert_for("login-user", "login-user-popup")
def log_in(see: PageView) -> Action:
    name, password = see.quoted()
    if see.rows("button", "Cancel"):  # a window has popped up
        return see.press_button("Cancel")
    action = see.fill({see.row("input_text"): name, see.row("input_password"): password})
    return action or see.click(see.row("button"))


@expert_for("multi-layouts", "multi-orderings")
def search_for_a_movie(see: PageView) -> Action:
    fields: dict[int, str] = {}
    texts = [row for row in range(len(see.page)) if see.page.text[row]]
    for pattern, asked in (
        ("Genre", see.words(r"for (\w+) movie")),
        ("Director", see.words(r"directed by (\w+)")),
        ("Year|Date", see.words(r"year (\d+)")),
    ):
        label = next(row for row in texts if re.search(pattern, see.page.text[row]))
        fields[_beside(see, label)] = asked
    return see.fill(fields) or see.click(max(row for row in texts if see.page.text[row] in ("Submit", "Search", "Go!")))


def _beside(see: PageView, label: int) -> int:
    """The field of the smallest part of the page that holds the label and a field."""
    around = int(see.page.parent[label])
    while not see.rows("input_text", inside=around):
        around = int(see.page.parent[around])
    return see.row("input_text", inside=around)


@expert_for("search-engine")
def click_the_nth_result(see: PageView) -> Action:
    wanted, nth = see.quoted()[0], int(see.words(ORDINAL)) - 1
    action = see.fill({see.row("input_text"): wanted})
    if action:
        return action
    titles = see.rows("a", kind="search-title")
    if not titles:
        return see.press_button("Search")
    page, place = divmod(nth, 3)
    shown = see.reading(see.row("li", kind="active"))
    return see.click(titles[place] if shown == str(page + 1) else see.row("a", str(page + 1)))


@expert_for("form-sequence-2")
def check_and_enter(see: PageView) -> Action:
    radio, field = (int(nth) - 1 for nth in re.findall(ORDINAL, see.said))
    button = see.rows("input_radio")[radio]
    if see.page.value[button] != "checked":
        return see.click(button)
    return see.fill({see.rows("input_text")[field]: see.quoted()[0]}) or see.press_button("Submit")


@expert_for("enter-text-2")
def enter_in_case(see: PageView) -> Action:
    text = see.quoted()[0]
    text = text.upper() if "upper case" in see.said else text.lower()
    return see.fill({see.row("input_text"): text}) or see.press_button("Submit")


@expert_for("enter-date")
def enter_the_date(see: PageView) -> Action:
    month, day, year = see.words(r"Enter (\S+) as").split("/")
    return see.fill({see.row("input_date"): f"{year}-{month}-{day}"}) or see.press_button("Submit")


@expert_for("enter-time")
def enter_the_time(see: PageView) -> Action:
    hour, minute, half = re.findall(r"(\d+):(\d+) ([AP]M)", see.said)[0]
    hour = int(hour) % 12 + (12 if half == "PM" else 0)
    return see.fill({see.row("input_time"): f"{hour:02}:{minute}"}) or see.press_button("Submit")


@expert_for("find-word")
def enter_the_nth_word(see: PageView) -> Action:
    word = see.reading(see.row("p")).split()[int(see.words(ORDINAL)) - 1].strip(",.")
    return see.fill({see.row("input_text"): word}) or see.press_button("Submit")


@expert_for("scroll-text")
def enter_the_last_word(see: PageView) -> Action:
    word = see.page.value[see.row("textarea")].split()[-1].strip(",.")
    return see.fill({see.row("input_text"): word}) or see.press_button("Submit")


@expert_for("copy-paste", "copy-paste-2")
def copy_the_text(see: PageView) -> Action:
    nth = re.search(ORDINAL, see.said)
    area = see.rows("textarea")[int(nth[1]) - 1 if nth else 0]
    return see.fill({see.row("input_text"): see.page.value[area]}) or see.press_button("Submit")


def _table(see: PageView) -> dict[str, str]:
    cells = [see.page.text[row] for row in see.rows("td")]
    return dict(zip(cells[::2], cells[1::2], strict=True))


@expert_for("read-table")
def enter_the_value(see: PageView) -> Action:
    value = _table(see)[see.words(r"value of (.+) into")]
    return see.fill({see.row("input_text"): value}) or see.press_button("Submit")


@expert_for("read-table-2")
def enter_the_values(see: PageView) -> Action:
    table = _table(see)
    names = [see.page.text[row].rstrip(":") for row in see.rows("label")]
    wanted = {field: table[name] for field, name in zip(see.rows("input_text"), names, strict=True)}
    return see.fill(wanted) or see.press_button("Submit")


@expert_for("simple-arithmetic", "simple-algebra")
def solve(see: PageView) -> Action:
    """`a + b =`, or an equation in x with one more number."""
    problem = next(see.page.text[row] for row in see.rows("div") if "=" in see.page.text[row])
    left, sign, right, result = re.findall(r"(\S+) ([-+x*]) (\S+) =\s*(\S*)", problem)[0]
    if not result:
        answer = {"+": int.__add__, "-": int.__sub__, "x": int.__mul__, "*": int.__mul__}[sign](int(left), int(right))
    elif left == "x":
        answer = int(result) - int(right) if sign == "+" else int(result) + int(right)
    else:
        answer = int(result) - int(left) if sign == "+" else int(left) - int(result)
    return see.fill({see.row("input_text"): str(answer)}) or see.press_button("Submit")


@expert_for("visual-addition")
def count_the_blocks(see: PageView) -> Action:
    blocks = len(see.rows(kind="addition-block"))
    return see.fill({see.row("input_text"): str(blocks)}) or see.press_button("Submit")


@expert_for("text-transform")
def read_the_letters(see: PageView) -> Action:
    text = "".join(see.page.text[row] for row in see.rows("span"))
    return see.fill({see.row("input_text"): text}) or see.press_button("Submit")


@expert_for("use-spinner")
def turn_the_spinner(see: PageView) -> Action:
    now, wanted = int(see.page.value[see.row("input_text")]), int(see.words(r"Select (-?\d+) with"))
    if now == wanted:
        return see.press_button("Submit")
    return see.click(see.leaf(see.row("a", kind="ui-spinner-up" if wanted > now else "ui-spinner-down")))


@expert_for("form-sequence-3")
def choose_then_press(see: PageView) -> Action:
    wanted = see.words(r"Choose (.+) from the dropdown")
    if see.page.text[see.row("span", kind="label")] == wanted:
        return see.press_button(see.quoted()[0])
    options = see.rows("li", wanted)
    return see.click(options[0] if options else see.row("span", kind="label"))


@expert_for("use-colorwheel")
def enter_the_colour(see: PageView) -> Action:
    colour = COLOURS[see.words(r"Select (\w+) with")]
    field = see.row("input_text")
    if see.page.value[field].lower() == colour:
        return see.press_button("Submit")
    return see.type(field, colour)


@expert_for("use-autocomplete", "use-autocomplete-nodelay")
def enter_an_item(see: PageView) -> Action:
    field = see.row("input_text")
    start, end = [*see.quoted(), ""][:2]
    value = see.page.value[field]
    if len(value) > len(start) and value.startswith(start) and value.endswith(end):
        return see.press_button("Submit")
    action = see.fill({field: start})
    return action or take_suggestion(see, lambda name: name.startswith(start) and name.endswith(end))


def take_suggestion(see: PageView, fits: Callable[[str], bool]) -> Action:
    """Click what fits among the suggestions below a field."""
    suggested = see.rows("div", kind="ui-menu-item-wrapper")
    return see.click(see.leaf(next(row for row in suggested if fits(see.reading(row)))))


@expert_for("terminal")
def delete_a_file(see: PageView) -> Action:
    """List the files, then remove one that ends as asked: each command typed, then Enter."""
    lines = [row for row in see.rows("div") if see.has(row, "terminal-line") or see.has(row, "terminal-output")]
    texts = [see.reading(row) for row in lines]
    listed = [i for i, text in enumerate(texts[:-1]) if text == "user$ ls"]
    command = f"rm {_file(see, texts[listed[0] + 1])}" if listed else "ls"
    field = see.row("input_text")
    typed = texts[-1].removeprefix("user$").removesuffix("█").strip()
    return see.press("Enter", field) if typed == command else see.type(field, command)


def _file(see: PageView, listing: str) -> str:
    ending = re.search(r"extension (\.\S+)$", see.said)
    return next(
        name
        for name in listing.split()
        if ("." not in name if ending is None else name.partition(".")[2] == ending[1][1:])
    )
