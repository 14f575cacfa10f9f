"""Pose selection: which of the verified poses can be true at once, and which points they explain."""
