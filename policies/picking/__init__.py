"""Pickers: the scripted one, how it executes a grasp, how a bin is driven to its end."""
