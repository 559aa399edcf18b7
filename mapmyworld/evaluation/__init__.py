"""How good a result is: trajectories, relations, grids, loop closures and clouds."""

from mapmyworld.evaluation.relations import RelationsScore, relations_score
from mapmyworld.evaluation.statistics import ErrorStatistics, summarise
from mapmyworld.evaluation.trajectory import TrajectoryScore, ate, rpe

__all__ = [
    "ErrorStatistics",
    "RelationsScore",
    "TrajectoryScore",
    "ate",
    "relations_score",
    "rpe",
    "summarise",
]
