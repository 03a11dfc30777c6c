"""Where pages come from: Chrome and its tabs, the MiniWoB tasks, human demonstrations, and a fake browser.

Importing the package makes `giirl/MiniWoB-v0` known to Gymnasium and loads nothing else: Chrome, and what speaks with
it, come with the first environment, or with the module that is wanted (`browser_farm.farm`, `browser_farm.fake`, ...).
"""

from gymnasium import register

register(
    id="giirl/MiniWoB-v0",
    entry_point="browser_farm.gym.env:MiniWoB",
    vector_entry_point="browser_farm.gym.vector_env:MiniWoBVector",
)
