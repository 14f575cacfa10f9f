"""Evaluations of segmentation and poses on synthetic scenes."""
