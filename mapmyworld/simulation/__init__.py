"""Worlds, a robot and a driver."""
