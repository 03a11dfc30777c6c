"""One Chrome process tree: launching and ending it, its tabs, and calls over the DevTools protocol."""
