"""Screenshots of a page of one's own."""

from __future__ import annotations

import base64

from browser_farm.sites.routines import Routine
from browser_farm.sites.session import Session

LEAST_SCALE = 0.5  # pixels per CSS px: less cannot be read


def png_of(session: Session, box: tuple[float, float, float, float], px: float, scale: float) -> Routine[bytes]:
    """PNG of a box whose unit is `px` CSS px, with `scale` pixels per unit, at least one for 2 CSS px. b"" if none."""
    left, top, width, height = (length * px for length in box)
    clip = {"x": left, "y": top, "width": width, "height": height, "scale": max(LEAST_SCALE, scale / px)}
    reply = yield from session.call("Page.captureScreenshot", {"format": "png", "clip": clip, "optimizeForSpeed": True})
    return base64.b64decode(reply["data"]) if reply else b""
