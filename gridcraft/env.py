"""LanguageGridCraft as a Gymnasium environment, for agents that were not written for this project.

`import gridcraft`, then `gymnasium.make("giirl/LanguageGridCraft-v0")`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, SupportsInt

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gridcraft.instructions import FORMS, SYNONYMS, Pair, draw_sentence, ordered_pairs, plain_sentence
from gridcraft.layouts import COLOURS, WALL, Layout, named_layout
from gridcraft.world import ACTIONS, HORIZON, build_world, draw_starts, step, true_reward

LONGEST_WORD = max(len(word) for words in SYNONYMS.values() for word in words)
LONGEST_INSTRUCTION = max(len(form) for form in FORMS) + 2 * LONGEST_WORD
CHARACTERS = "".join(sorted(set("".join([*FORMS, *(w + w.capitalize() for ws in SYNONYMS.values() for w in ws)]))))
SYMBOL = dict(zip(range(WALL, len(COLOURS) + 1), "#.RGBY", strict=True))

Observed = dict[str, Any]  # "cells" [H, W], "position" [2] row and column, "instruction" in English


class LanguageGridCraft(gymnasium.Env[Observed, SupportsInt]):
    """One layout; every episode starts on a white cell with an instruction for a pair of its colours."""

    metadata: dict[str, Any] = {"render_modes": ["ansi"], "render_fps": 4}  # noqa: RUF012 (as Gymnasium declares it)

    def __init__(
        self,
        layout: str | Layout = "regions",
        *,
        pairs: tuple[Pair, ...] = (),  # what may be asked; empty asks for every pair of the layout's colours
        plain: bool = False,  # always "Go to X. Avoid Y."
        slip: float = 0.0,
        horizon: int = HORIZON,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, "ansi"):
            raise ValueError(f"the grid cannot render as {render_mode!r}, wanted 'ansi' or nothing")
        if horizon < 1:
            raise ValueError(f"the horizon is {horizon} steps, wanted at least 1")
        self.layout = named_layout(layout) if isinstance(layout, str) else layout
        self.world = build_world([self.layout], slip)
        self.pairs = pairs or ordered_pairs(self.layout.colours)
        if not self.pairs:
            raise ValueError(f"layout {self.layout.name!r} has fewer than two colours: there is nothing to ask for")
        self.rewards = {pair: true_reward(self.world, pair)[:, 0] for pair in self.pairs}
        self.plain, self.horizon, self.render_mode = plain, horizon, render_mode
        self.action_space = spaces.Discrete(len(ACTIONS))
        shape = self.layout.cells.shape
        self.observation_space = spaces.Dict(
            {
                "cells": spaces.Box(WALL, len(COLOURS), shape, np.int8),
                "position": spaces.MultiDiscrete(np.array(shape)),
                "instruction": spaces.Text(LONGEST_INSTRUCTION, charset=CHARACTERS),
            }
        )
        self.pair, self.instruction, self.state, self.taken = self.pairs[0], "", np.zeros(1, dtype=np.int64), 0

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """A new episode; `options={"pair": Pair(...)}` asks for this pair."""
        super().reset(seed=seed)
        asked = dict(options or {})
        pair = asked.pop("pair", None) or self.pairs[int(self.np_random.integers(len(self.pairs)))]
        if asked or pair not in self.rewards:
            raise ValueError(f"reset got options {dict(options or {})}, wanted {{'pair': one of {self.pairs}}}")
        self.pair, self.taken = pair, 0
        self.instruction = plain_sentence(pair) if self.plain else draw_sentence(pair, self.np_random)
        self.state = draw_starts(self.world, 1, self.np_random)
        return self._observe(), self._describe()

    def step(self, action: SupportsInt) -> tuple[Observed, float, bool, bool, dict[str, Any]]:
        """Pays for the cell the agent stands on when it acts; only the horizon ends an episode."""
        if not self.action_space.contains(action):
            raise ValueError(f"there is no action {action!r}: wanted 0 to {len(ACTIONS) - 1}, {', '.join(ACTIONS)}")
        reward = float(self.rewards[self.pair][self.state[0]])
        self.state = step(self.world, self.state, np.array([int(action)]), self.np_random)
        self.taken += 1
        return self._observe(), reward, False, self.taken >= self.horizon, self._describe()

    def render(self) -> str | None:
        """The instruction and the map with the agent as @, or nothing where no mode was asked for."""
        if self.render_mode is None:
            return None
        rows = [[SYMBOL[int(cell)] for cell in row] for row in self.layout.cells]
        row, column = self._position()
        rows[row][column] = "@"
        return "\n".join([self.instruction, *("".join(line) for line in rows)])

    def _position(self) -> NDArray[np.int64]:
        position: NDArray[np.int64] = self.world.position[self.state[0]]
        return position

    def _observe(self) -> Observed:
        return {
            "cells": self.layout.cells.copy(),
            "position": self._position().copy(),
            "instruction": self.instruction,
        }

    def _describe(self) -> dict[str, Any]:
        return {"goal": self.pair.goal, "avoid": self.pair.avoid, "state": int(self.state[0])}
