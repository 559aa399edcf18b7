"""Frames become motion."""
