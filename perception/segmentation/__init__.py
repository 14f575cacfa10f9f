"""Boundary points to instances."""
