"""Boundary segments to 6D poses."""
