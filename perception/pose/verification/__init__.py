"""Refinement and verification of pose hypotheses against the frame."""
