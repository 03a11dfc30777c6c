"""The `giirl` command as a fixture."""

from tests.command import giirl

__all__ = ["giirl"]
