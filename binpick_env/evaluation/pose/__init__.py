"""Pose estimation judged on synthetic scenes: records, summaries, tables, pictures."""
