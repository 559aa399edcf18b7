from mapmyworld.api import Built as Built
from mapmyworld.api import build as build
from mapmyworld.api import configured as configured
from mapmyworld.config import Config as Config
from mapmyworld.errors import MapMyWorldError as MapMyWorldError
from mapmyworld.evaluation import ate as ate
from mapmyworld.evaluation import grid_score as grid_score
from mapmyworld.evaluation import relations_score as relations_score
from mapmyworld.evaluation import rpe as rpe
from mapmyworld.mapping.cloud import build_cloud as build_cloud
from mapmyworld.mapping.occupancy import build_grid as build_grid
from mapmyworld.memory_log import MemoryLog as MemoryLog
from mapmyworld.memory_map import MemoryMap as MemoryMap
from mapmyworld.pipeline import BuildResult as BuildResult
from mapmyworld.sensing import make_plan as make_plan
from mapmyworld.sensing import survey_log as survey_log

__version__: str
