"""Recorded logs of every kind behind one function: open_log."""

from formats.logs.opening_logs import open_log

__all__ = ["open_log"]
