"""Boundary points, instance segmentation and 6D poses from a depth camera's arrays. Knows no simulator."""
