"""Pose hypotheses: voting over point pair features."""
