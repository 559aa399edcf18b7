"""What is wrong with a recording: sensors compared with one another before a map is made."""

from mapmyworld.diagnosis.finding import Finding
from mapmyworld.diagnosis.tracked import diagnose, diagnose_tracked

__all__ = ["Finding", "diagnose", "diagnose_tracked"]
