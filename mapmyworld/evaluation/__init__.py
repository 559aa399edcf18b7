"""How good a result is: trajectories, relations, grids, loop closures and clouds."""

from mapmyworld.evaluation.cloud_error import cloud_distances, cloud_score
from mapmyworld.evaluation.error_statistics import ErrorStatistics, summarise
from mapmyworld.evaluation.grid_agreement import GridAgreement, GridScore, grid_score
from mapmyworld.evaluation.loops import LoopScore, loop_closure_score
from mapmyworld.evaluation.relations_metric import FEW, RelationsScore, relations_score
from mapmyworld.evaluation.trajectory_error import TrajectoryScore, ate, rpe
