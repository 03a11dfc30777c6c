"""giirl_core."""
