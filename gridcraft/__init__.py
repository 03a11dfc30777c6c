"""LanguageGridCraft (Luo 2019, section 4.1): the tabular world, an exact planner and reward metrics.

Importing the package registers `giirl/LanguageGridCraft-v0` with Gymnasium and imports no other module of the package.
"""

from gymnasium import register

register(id="giirl/LanguageGridCraft-v0", entry_point="gridcraft.env:LanguageGridCraft")
