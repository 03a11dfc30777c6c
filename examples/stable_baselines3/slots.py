"""MiniWoB for agents with a fixed number of discrete actions: each slot is an element that can be clicked."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from giirl_core.types import NO_SPAN, Goal, Page

SLOTS = 12  # elements; further ones of a page cannot be clicked
FEATURES = ("is there", "button", "link", "field", "named in the goal", "words in the goal", "tampered", "left", "top")
WIDTH, HEIGHT = 160.0, 210.0  # CSS px of a MiniWoB page


class ElementSlots(gymnasium.Wrapper[NDArray[np.float32], Any, Any, Any]):
    """Observations are features of the first SLOTS elements without children, an action is the number of one.

    The environment needs `agent_page=True`. An action on an empty slot waits.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        self.observation_space = gymnasium.spaces.Box(0.0, 1.0, (SLOTS * len(FEATURES),), np.float32)
        self.action_space = gymnasium.spaces.Discrete(SLOTS)
        self._refs: list[int] = []
        self._bare: Any = env.unwrapped

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode."""
        _, info = self.env.reset(seed=seed, options=options)
        return self._observe(info), _without_page(info)

    def step(self, action: Any) -> tuple[NDArray[np.float32], Any, bool, bool, dict[str, Any]]:
        """Click the element in a slot."""
        ref = self._refs[int(action)] if int(action) < len(self._refs) else 0
        click = self._bare.create_action("CLICK_ELEMENT", ref=ref) if ref else None
        _, reward, terminated, truncated, info = self.env.step(click)
        return self._observe(info), reward, terminated, truncated, _without_page(info)

    def _observe(self, info: dict[str, Any]) -> NDArray[np.float32]:
        observation = np.zeros((SLOTS, len(FEATURES)), np.float32)
        if "page" in info:
            page: Page = info["page"]
            rows = np.flatnonzero(page.leaf & (page.ref > 0))[:SLOTS].tolist()
            self._refs = [int(page.ref[row]) for row in rows]
            for slot, row in enumerate(rows):
                observation[slot] = features(page, row, info["goal"])
        return observation.ravel()


def features(page: Page, row: int, goal: Goal) -> tuple[float, ...]:
    """FEATURES of one element under a goal."""
    tag, text = page.tag[row], page.text[row]
    words, wanted = text.lower().split(), {token.lower() for token in goal.tokens}
    left, top, width, height = page.box[row].tolist()
    return (
        1.0,
        tag == "button",
        tag in ("a", "span"),
        tag.startswith("input"),
        bool(text) and goal.find(text)[0] != NO_SPAN,
        sum(word in wanted for word in words) / max(len(words), 1),
        bool(page.tampered[row]),
        float(np.clip((left + width / 2) / WIDTH, 0, 1)),
        float(np.clip((top + height / 2) / HEIGHT, 0, 1)),
    )


def _without_page(info: dict[str, Any]) -> dict[str, Any]:
    """What Stable-Baselines3 has to carry along."""
    return {key: value for key, value in info.items() if key not in ("page", "goal", "action")}
