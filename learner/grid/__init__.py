"""GIIRL in LanguageGridCraft: networks, steps and training state of the tabular world."""
