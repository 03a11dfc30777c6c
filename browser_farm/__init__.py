"""Where pages come from: Chrome and its tabs, the MiniWoB tasks, human demonstrations, and a fake browser.

Import the module that is wanted (`browser_farm.farm`, `browser_farm.fake`, ...): this package loads nothing.
"""
