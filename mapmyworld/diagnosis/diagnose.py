"""All comparisons of one log."""

from __future__ import annotations

from mapmyworld.config import Config
from mapmyworld.diagnosis.cameras import camera_findings
from mapmyworld.diagnosis.finding import Finding
from mapmyworld.diagnosis.lasers import laser_findings
from mapmyworld.diagnosis.sample import take_sample
from mapmyworld.sensing.plan import Plan
from mapmyworld.types import LogSource


def diagnose(log: LogSource, plan: Plan, config: Config) -> tuple[Finding, ...]:
    """What the sensors of a log report about one another, from its first minutes of motion."""
    sample = take_sample(log, plan, config.sensing)
    if not sample.frames:
        return ()
    return (*laser_findings(sample, config.registration), *camera_findings(sample, config))
