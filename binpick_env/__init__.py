"""The simulated bin-picking cell."""
