"""The pose graph: optimised, judged, explained. The only room that imports gtsam."""

from mapmyworld.graph.optimise import OptimisedGraph, optimise
from mapmyworld.graph.pose_graph import graph_from_constraints
from mapmyworld.graph.solve import SolvedGraph, solve

__all__ = ["OptimisedGraph", "SolvedGraph", "graph_from_constraints", "optimise", "solve"]
