"""Names of CSS colours, so that the colour of an element can be compared with the words of a goal."""

from __future__ import annotations

import colorsys
import functools
import re

_RGB = re.compile(r"rgba?\((\d{1,3}), ?(\d{1,3}), ?(\d{1,3})\b")
_HEX = re.compile(r"#[0-9a-fA-F]{6}")
NAMED = {
    "aqua": (0, 255, 255),
    "black": (0, 0, 0),
    "blue": (0, 0, 255),
    "brown": (165, 42, 42),
    "cyan": (0, 255, 255),
    "gray": (128, 128, 128),
    "green": (0, 128, 0),
    "grey": (128, 128, 128),
    "lime": (0, 255, 0),
    "magenta": (255, 0, 255),
    "maroon": (128, 0, 0),
    "navy": (0, 0, 128),
    "olive": (128, 128, 0),
    "orange": (255, 165, 0),
    "pink": (255, 192, 203),
    "purple": (128, 0, 128),
    "red": (255, 0, 0),
    "silver": (192, 192, 192),
    "teal": (0, 128, 128),
    "violet": (238, 130, 238),
    "white": (255, 255, 255),
    "yellow": (255, 255, 0),
}
COLOURS = frozenset(NAMED)
# One name for each twelfth of the hue circle.
_HUES = ("red", "orange", "yellow", "green", "green", "green", "cyan", "cyan", "blue", "purple", "magenta", "pink")


@functools.lru_cache(maxsize=1 << 12)
def colour_names(colour: str) -> tuple[str, ...]:
    """The names of a CSS colour, or the name of its hue if it has none. () for "" and unknown notations."""
    parts = _channels(colour)
    if parts is None:
        return ()
    names = tuple(name for name, channels in NAMED.items() if channels == parts)
    if names:
        return names
    hue, lightness, saturation = colorsys.rgb_to_hls(*(part / 255 for part in parts))
    if saturation < 0.08:
        return ("white" if lightness > 0.9 else "black" if lightness < 0.1 else "gray",)
    return (_HUES[int(hue * 12 + 0.5) % 12],)


def _channels(colour: str) -> tuple[int, int, int] | None:
    """Red, green and blue from 0 to 255, None for "" and unknown notations."""
    if colour.lower() in NAMED:
        return NAMED[colour.lower()]
    found = _RGB.match(colour)
    if found is not None:
        red, green, blue = (int(part) for part in found.groups())
        return red, green, blue
    if _HEX.fullmatch(colour):
        return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
    return None
