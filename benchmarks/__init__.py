"""Benchmarks of the browser farm, the Gymnasium environments, message transport and crash recovery."""
