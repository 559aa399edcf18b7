"""Simulated worlds, a robot with faults, a driver, and the truth beside the recorded log."""

from mapmyworld.simulation.robot_settings import SimulationSettings
from mapmyworld.simulation.simulated_recording import Recording, simulate
from mapmyworld.simulation.world import World
from mapmyworld.simulation.worlds import WORLDS, find_world

__all__ = ["WORLDS", "Recording", "SimulationSettings", "World", "find_world", "simulate"]
