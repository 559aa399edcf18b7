"""Recorded logs of every kind behind one function: open_log."""
