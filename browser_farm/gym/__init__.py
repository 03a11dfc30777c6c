"""MiniWoB++ as Gymnasium environments, with the observations and actions of the `miniwob` package."""
