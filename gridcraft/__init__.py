"""LanguageGridCraft: the thesis's tabular world, its exact planner and its reward metrics.

Importing the package registers `giirl/LanguageGridCraft-v0` with Gymnasium and loads nothing else.
"""

from gymnasium import register

register(id="giirl/LanguageGridCraft-v0", entry_point="gridcraft.env:LanguageGridCraft")
