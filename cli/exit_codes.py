"""What a command's exit code says; 0 is done."""

from __future__ import annotations

EXIT_USAGE = 1
EXIT_BAD_INPUT = 2
EXIT_PARTIAL = 3
"""Something was made, something was lost: stderr says what."""
EXIT_CHECK_FAILED = 4
EXIT_INTERRUPTED = 130
