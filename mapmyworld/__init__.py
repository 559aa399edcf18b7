"""Recorded robot logs become maps, offline."""

__version__ = "0.1.0"
