"""How good a result is: trajectories, relations, grids, loop closures and clouds."""

from mapmyworld.evaluation.cloud import cloud_distances, cloud_score
from mapmyworld.evaluation.grid import GridAgreement, GridScore, grid_score
from mapmyworld.evaluation.loops import LoopScore, loop_closure_score
from mapmyworld.evaluation.relations import FEW, RelationsScore, relations_score
from mapmyworld.evaluation.statistics import ErrorStatistics, summarise
from mapmyworld.evaluation.trajectory import TrajectoryScore, ate, rpe

__all__ = [
    "FEW",
    "ErrorStatistics",
    "GridAgreement",
    "GridScore",
    "LoopScore",
    "RelationsScore",
    "TrajectoryScore",
    "ate",
    "cloud_distances",
    "cloud_score",
    "grid_score",
    "loop_closure_score",
    "relations_score",
    "rpe",
    "summarise",
]
