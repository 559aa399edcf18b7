"""The command line: parse, call, show."""

import os

# Before numpy loads. The matrices here are small: more threads of linear algebra cost two to ten
# times the processor's time and gain none, and sums would depend on their number.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
