"""Gymnasium environments on Chrome with the spaces, observations and actions of the `miniwob` package."""
