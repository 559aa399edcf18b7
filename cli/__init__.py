"""The command line: parse, call, show."""

import _signal as signal  # type: ignore[import-not-found]  # loads at once, `signal` does not
import os
import sys

# Before numpy loads. The matrices here are small: more threads of linear algebra cost two to ten
# times the processor's time and gain none, and sums would depend on their number.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Before numba loads. Its coloured errors, which no user sees, would have colorama send the terminal
# a code when the program ends.
os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")

# Until the program heeds it, Ctrl-C ends it without a traceback; of others who import this, nothing
# is changed. (`-m` stands there while a package is imported that is about to be run.)
_begins = os.path.basename(sys.argv[0]) in {"mapmyworld", "-m"}
if _begins and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
