"""Keys as pages name them: what may be pressed, and the codes that keyboard events carry."""

from __future__ import annotations

import functools

# The `key` of a KeyboardEvent, with the code that pages of MiniWoB's age still read.
NAMED = {
    "Backspace": 8,
    "Tab": 9,
    "Enter": 13,
    "Shift": 16,
    "Control": 17,
    "Alt": 18,
    "Pause": 19,
    "Escape": 27,
    "PageUp": 33,
    "PageDown": 34,
    "End": 35,
    "Home": 36,
    "ArrowLeft": 37,
    "ArrowUp": 38,
    "ArrowRight": 39,
    "ArrowDown": 40,
    "Insert": 45,
    "Delete": 46,
    "Meta": 91,
    **{f"F{number}": 111 + number for number in range(1, 13)},
}
MODIFIERS = {"Alt": 1, "Control": 2, "Meta": 4, "Shift": 8}  # bits as in Chrome's Input domain
# Characters of a US keyboard beside letters and digits, by the code of the key that gives them.
PUNCTUATION = {
    ";:": 186,
    "=+": 187,
    ",<": 188,
    "-_": 189,
    ".>": 190,
    "/?": 191,
    "`~": 192,
    "[{": 219,
    "\\|": 220,
    "]}": 221,
    "'\"": 222,
}
SHIFTED_DIGITS = ")!@#$%^&*("
CODES = {
    " ": 32,
    **{character: code for pair, code in PUNCTUATION.items() for character in pair},
    **{character: ord("0") + digit for digit, character in enumerate(SHIFTED_DIGITS)},
}


@functools.lru_cache(maxsize=1024)
def chord(keys: str) -> tuple[int, str]:
    """The modifiers (bits) and the key of "Enter", "a", "Control+Shift+ArrowLeft"; ValueError for what is none."""
    before, plus, key = keys[:-1].rpartition("+")  # the last character is no separator: it may be a plus itself
    held, key = set(before.split("+")) if plus else set(), key + keys[-1:]
    if not (key in NAMED or len(key) == 1) or not held <= MODIFIERS.keys():
        raise ValueError(
            f"{keys!r} is no key: wanted one character or one of {', '.join(NAMED)}, "
            f"after any of {', '.join(MODIFIERS)} and a plus, as in Control+c"
        )
    return sum(MODIFIERS[name] for name in held), key


def key_code(key: str) -> int:
    """The code of a key of a US keyboard; 0 where it has none."""
    if key in NAMED:
        return NAMED[key]
    upper = key.upper()
    return ord(upper) if upper.isascii() and upper.isalnum() else CODES.get(key, 0)
