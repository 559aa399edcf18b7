"""Messages become frames: what a log holds, what of it to use, what belongs together."""

from mapmyworld.sensing.plan import Plan
from mapmyworld.sensing.planning import make_plan
from mapmyworld.sensing.survey import Survey, survey_log
from mapmyworld.sensing.synchronise import read_frames

__all__ = ["Plan", "Survey", "make_plan", "read_frames", "survey_log"]
