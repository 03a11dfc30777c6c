"""LanguageGridCraft as a Gymnasium environment, usable without the rest of this project.

`import gridcraft`, then `gymnasium.make("giirl/LanguageGridCraft-v0")`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, SupportsInt

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gridcraft.instructions import SYNONYMS, TEMPLATES, ColourPair, ordered_pairs, plain_sentence, sample_sentence
from gridcraft.layouts import COLOURS, SYMBOL_OF, WALL, Layout, named_layout
from gridcraft.world import ACTIONS, HORIZON, build_world, sample_starts, step, true_reward

MAX_WORD_CHARS = max(len(word) for words in SYNONYMS.values() for word in words)
MAX_INSTRUCTION_CHARS = max(len(template) for template in TEMPLATES) + 2 * MAX_WORD_CHARS
CHARACTERS = "".join(sorted(set("".join([*TEMPLATES, *(w + w.capitalize() for ws in SYNONYMS.values() for w in ws)]))))

GridObservation = dict[str, Any]  # "cells" [H, W], "position" [2] (row, column), "instruction" in English


class LanguageGridCraft(gymnasium.Env[GridObservation, SupportsInt]):
    """One layout. Each episode starts on a white cell with an instruction about two of the layout's colours.

    Raises ValueError for an unknown layout or render mode, a horizon below 1, or a layout with fewer than two colours.
    """

    metadata: dict[str, Any] = {"render_modes": ["ansi"], "render_fps": 4}  # noqa: RUF012 (as Gymnasium declares it)

    def __init__(
        self,
        layout: str | Layout = "regions",
        *,
        pairs: tuple[ColourPair, ...] = (),  # pairs that episodes are sampled from; empty means all pairs of the layout
        plain: bool = False,  # always use the template "Go to X. Avoid Y."
        slip: float = 0.0,
        horizon: int = HORIZON,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, "ansi"):
            raise ValueError(f"the grid cannot render as {render_mode!r}, wanted 'ansi' or None")
        if horizon < 1:
            raise ValueError(f"the horizon is {horizon} steps, wanted at least 1")
        self.layout = named_layout(layout) if isinstance(layout, str) else layout
        self.world = build_world([self.layout], slip)
        self.pairs = pairs or ordered_pairs(self.layout.colours)
        if not self.pairs:
            raise ValueError(f"layout {self.layout.name!r} has {len(self.layout.colours)} colours, wanted at least 2")
        self.rewards = {pair: true_reward(self.world, pair)[:, 0] for pair in self.pairs}
        self.plain, self.horizon, self.render_mode = plain, horizon, render_mode
        self.action_space = spaces.Discrete(len(ACTIONS))
        shape = self.layout.cells.shape
        self.observation_space = spaces.Dict(
            {
                "cells": spaces.Box(WALL, len(COLOURS), shape, np.int8),
                "position": spaces.MultiDiscrete(np.array(shape)),
                "instruction": spaces.Text(MAX_INSTRUCTION_CHARS, charset=CHARACTERS),
            }
        )
        self.pair, self.instruction, self.state, self.elapsed_steps = self.pairs[0], "", np.zeros(1, dtype=np.int64), 0

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[GridObservation, dict[str, Any]]:
        """Start an episode. `options={"pair": ColourPair(...)}` sets its pair; other options are a ValueError."""
        super().reset(seed=seed)
        remaining = dict(options or {})
        pair = remaining.pop("pair", None) or self.pairs[int(self.np_random.integers(len(self.pairs)))]
        if remaining or pair not in self.rewards:
            raise ValueError(f"reset got options {dict(options or {})}, wanted {{'pair': one of {self.pairs}}}")
        self.pair, self.elapsed_steps = pair, 0
        self.instruction = plain_sentence(pair) if self.plain else sample_sentence(pair, self.np_random)
        self.state = sample_starts(self.world, 1, self.np_random)
        return self._observe(), self._info()

    def step(self, action: SupportsInt) -> tuple[GridObservation, float, bool, bool, dict[str, Any]]:
        """Take one action. The reward is that of the cell the agent stands on before it moves.

        Episodes never terminate; they are truncated at the horizon. ValueError for an action out of range.
        """
        if not self.action_space.contains(action):
            raise ValueError(f"there is no action {action!r}: wanted 0 to {len(ACTIONS) - 1}, {', '.join(ACTIONS)}")
        reward = float(self.rewards[self.pair][self.state[0]])
        self.state = step(self.world, self.state, np.array([int(action)]), self.np_random)
        self.elapsed_steps += 1
        return self._observe(), reward, False, self.elapsed_steps >= self.horizon, self._info()

    def render(self) -> str | None:
        """The instruction and the map with the agent as @; None without a render mode."""
        if self.render_mode is None:
            return None
        rows = [[SYMBOL_OF[int(cell)] for cell in row] for row in self.layout.cells]
        row, column = self._position()
        rows[row][column] = "@"
        return "\n".join([self.instruction, *("".join(line) for line in rows)])

    def _position(self) -> NDArray[np.int64]:
        position: NDArray[np.int64] = self.world.position[self.state[0]]
        return position

    def _observe(self) -> GridObservation:
        return {
            "cells": self.layout.cells.copy(),
            "position": self._position().copy(),
            "instruction": self.instruction,
        }

    def _info(self) -> dict[str, Any]:
        return {"goal": self.pair.goal, "avoid": self.pair.avoid, "state": int(self.state[0])}
