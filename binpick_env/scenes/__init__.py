"""Labelled synthetic scenes for training and evaluation."""
