"""Keyboard keys: their names in `KeyboardEvent.key`, their key codes, and the parsing of key combinations."""

from __future__ import annotations

import functools

# Values of KeyboardEvent.key, with the deprecated `keyCode` that MiniWoB's pages still read.
NAMED_KEYS = {
    "Unidentified": 0,
    "Cancel": 3,
    "Backspace": 8,
    "Tab": 9,
    "Clear": 12,
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
    "Help": 47,
    "Meta": 91,
    **{f"F{number}": 111 + number for number in range(1, 13)},
    "ZenkakuHankaku": 243,
}
MODIFIERS = {"Alt": 1, "Control": 2, "Meta": 4, "Shift": 8}  # bits as in Chrome's Input domain
# The other characters of a US keyboard (unshifted and shifted), with the code of their key.
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
CHARACTER_CODES = {
    " ": 32,
    **{character: code for pair, code in PUNCTUATION.items() for character in pair},
    **{character: ord("0") + digit for digit, character in enumerate(SHIFTED_DIGITS)},
}
# Characters that press a key when they are typed (https://www.w3.org/TR/webdriver/#keyboard-actions).
_WEBDRIVER_RANGES = {
    0xE000: "Unidentified Cancel Help Backspace Tab Clear Enter Enter Shift Control Alt Pause Escape",
    0xE00E: "PageUp PageDown End Home ArrowLeft ArrowUp ArrowRight ArrowDown Insert Delete",
    0xE018: "; = 0 1 2 3 4 5 6 7 8 9 * + , - . /",
    0xE031: "F1 F2 F3 F4 F5 F6 F7 F8 F9 F10 F11 F12 Meta",
    0xE040: "ZenkakuHankaku",
    0xE050: "Shift Control Alt Meta PageUp PageDown End Home ArrowLeft ArrowUp ArrowRight ArrowDown Insert Delete",
}
TYPED_KEYS = {
    "\n": "Enter",
    chr(0xE00D): " ",
    **{chr(first + n): key for first, keys in _WEBDRIVER_RANGES.items() for n, key in enumerate(keys.split())},
}


@functools.lru_cache(maxsize=1024)
def parse_chord(keys: str) -> tuple[int, str]:
    """The modifiers (bits of MODIFIERS) and the key of a combination like "Enter", "a", "Control+Shift+ArrowLeft".

    Raises ValueError when `keys` is not such a combination.
    """
    prefix, plus, key = keys[:-1].rpartition("+")  # the last character is not a separator: it may be the key "+"
    modifiers, key = set(prefix.split("+")) if plus else set(), key + keys[-1:]
    if not (key in NAMED_KEYS or len(key) == 1) or not modifiers <= MODIFIERS.keys():
        raise ValueError(
            f"{keys!r} is not a key: wanted one character or one of {', '.join(NAMED_KEYS)}, "
            f"optionally after {', '.join(MODIFIERS)} and a plus, as in Control+c"
        )
    return sum(MODIFIERS[name] for name in modifiers), key


def key_code(key: str) -> int:
    """The `keyCode` of a key on a US keyboard; 0 when it has none."""
    if key in NAMED_KEYS:
        return NAMED_KEYS[key]
    upper = key.upper()
    return ord(upper) if upper.isascii() and upper.isalnum() else CHARACTER_CODES.get(key, 0)
