"""What is wrong with a recording: sensors compared with one another before a map is made."""

from mapmyworld.diagnosis.diagnose import diagnose
from mapmyworld.diagnosis.finding import Finding

__all__ = ["Finding", "diagnose"]
