"""Which actions a task accepts in place of the one that a person took, for `benchmarks.reading.next_action`."""

from __future__ import annotations

from giirl_core.types import Action, Page, Trajectory

# Tasks whose instruction fixes the order of similar elements.
ORDERED = frozenset({"click-button-sequence", "tic-tac-toe", "choose-date-nodelay", "use-spinner"})
# Tasks in which a person opens one section after another until the link is found: all of them are equally good.
SEARCHES = frozenset({"click-collapsible-2-nodelay", "click-tab-2", "click-tab-2-hard", "navigate-tree"})
CONTROLS = frozenset({"a", "button", "label", "li", "td", "h3", "option"})  # clicking a part of it is clicking it


def control(page: Page, row: int) -> int:
    """The ref of the control that a click on a row activates: its nearest ancestor in CONTROLS, or a text's parent."""
    at = row
    while at >= 0:
        if page.tag[at] in CONTROLS:
            return int(page.ref[at])
        at = int(page.parent[at])
    parent = int(page.parent[row])
    return int(page.ref[parent if page.tag[row] == "t" and parent >= 0 else row])


def accepted(trajectory: Trajectory, t: int, guess: Action) -> bool:
    """Whether the task accepts a predicted action at step t as well as the person's.

    It does if the prediction is on the same control, or on one with the same tag, classes and text (not ""). It also
    does if the person took the same action later, on an element with the same tag, and the order is free. In a search,
    any section is accepted. Some tasks have rules of their own.
    """
    page, done, goal = trajectory.pages[t], trajectory.actions[t], trajectory.goal
    if guess.verb is not done.verb:
        return False
    a, b = guess.element, done.element
    if control(page, a) == control(page, b) or (look(page, a) == look(page, b) and page.text[a]):
        typed, wanted = guess.text(goal), done.text(goal)
        longer = (
            trajectory.task == "book-flight-nodelay"
            and typed
            and (typed.startswith(wanted) or wanted.startswith(typed))
        )
        return typed == wanted or bool(longer)  # a list offers the same towns for a part of a name
    if trajectory.task == "click-shape":
        return _fits_alike(page, a, b, set(goal.tokens))
    if trajectory.task == "tic-tac-toe":
        return _as_good(page, a, b)
    if trajectory.task == "click-widget":
        return page.tag[a] == page.tag[b]
    if trajectory.task == "use-autocomplete-nodelay" and "ends" not in goal.tokens:
        return look(page, a)[0] == look(page, b)[0] and page.text[a][:2].lower() == page.text[b][:2].lower()
    if page.classes[a] == page.classes[b] == "page-link" and page.text[a] == ">":
        active = [
            int(t)
            for t, r in zip(page.text, page.parent, strict=True)
            if r >= 0 and "active" in page.classes[r] and t.isdigit()
        ]
        return page.text[b].isdigit() and bool(active) and int(page.text[b]) > active[0]
    if page.classes[a].startswith("email-") and page.parent[a] == page.parent[b]:
        return True  # any part of a message opens it
    if trajectory.task == "click-pie-nodelay":
        return _on_sector(page, a, b)
    if trajectory.task in SEARCHES and t + 1 < len(trajectory):
        last = trajectory.actions[-1].element
        found = control(trajectory.pages[-1], last) == control(page, a)  # sooner than the person did
        closed = page.classes[_parent(page, a)].startswith("expandable")
        like = page.tag[a] == page.tag[b] and page.tag[_parent(page, a)] == page.tag[_parent(page, b)]
        return found or (closed if trajectory.task == "navigate-tree" else like)
    if trajectory.task in ORDERED or page.tag[a] != page.tag[b]:
        return False
    return any(
        later.verb is guess.verb
        and control(trajectory.pages[s], later.element) == control(page, a)
        and later.text(goal) == guess.text(goal)
        for s, later in enumerate(trajectory.actions)
        if s > t
    )


def _fits_alike(page: Page, a: int, b: int, words: set[str]) -> bool:
    """Whether two drawings fit the same instruction. False if it names a colour, because recordings have none."""
    if words & {"red", "green", "blue", "aqua", "black", "magenta", "yellow"} or not words & {
        "item",
        "shape",
        "letter",
        "digit",
    }:
        return False
    kinds = [_drawn(page, row) for row in (a, b)]
    if not words & {"item"} and kinds[0] != kinds[1]:
        return False
    sizes = page.box[[a, b], 3]
    return not words & {"small", "large"} or bool(sizes.min() > 0.7 * sizes.max())


def _drawn(page: Page, row: int) -> str:
    if page.tag[row] != "text":
        return "shape"
    return "digit" if page.text[row].isdigit() else "letter"


def _as_good(page: Page, a: int, b: int) -> bool:
    """Whether a move of tic-tac-toe is as good as the person's: winning, blocking, or on a free cell."""
    cells = [row for row in range(len(page)) if page.tag[row] == "span"]
    if len(cells) != 9 or a not in cells or b not in cells:
        return False
    board = ["x" if "mark-x" in page.classes[c] else "o" if "mark-o" in page.classes[c] else "" for c in cells]
    lines = [(0, 1, 2), (3, 4, 5), (6, 7, 8), (0, 3, 6), (1, 4, 7), (2, 5, 8), (0, 4, 8), (2, 4, 6)]

    def value(cell: int) -> int:
        if board[cell]:
            return -1
        others = [sorted(board[c] for c in line if c != cell) for line in lines if cell in line]
        return 2 if ["x", "x"] in others else 1 if ["o", "o"] in others else 0

    return value(cells.index(a)) >= max(0, value(cells.index(b)))


def _on_sector(page: Page, a: int, b: int) -> bool:
    """Whether one row is a sector and the other is a label on it."""
    if {page.tag[a], page.tag[b]} != {"path", "tspan"}:
        return False
    sector, label = (a, b) if page.tag[a] == "path" else (b, a)
    left, top, width, height = page.box[sector]
    x, y = page.box[label, :2] + page.box[label, 2:] / 2
    return bool(left <= x <= left + width and top <= y <= top + height)


def _parent(page: Page, row: int) -> int:
    return max(0, int(page.parent[row]))


def look(page: Page, row: int) -> tuple[str, ...]:
    """Tag, text, value and classes of a row."""
    return page.tag[row], page.text[row], page.value[row], page.classes[row]
