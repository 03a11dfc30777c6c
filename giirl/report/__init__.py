"""HTML reports of a run: numbers, charts, heat maps, and pages overlaid with the learned reward of each element."""
