"""What an operator does with runs: start or go on, see their state, stop them, and clean up after dead ones."""
