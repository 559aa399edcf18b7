"""One writer a map: a second build on the same file is refused."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mapmyworld.errors import MapError


@contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Holds `path`.lock while the map is written; raises MapError where another process does.

    The system frees the lock of a killed process, so that nothing needs to be cleaned up. SQLite's
    own locks do not do: a build holds them only while it writes.
    """
    real = Path(os.path.realpath(path))  # so that a map has one lock, whatever links lead to it
    lock = real.with_name(f"{real.name}.lock")
    handle = _locked(lock, path)
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)  # before the lock is freed: whoever waits looks again
        os.close(handle)


def _locked(lock: Path, path: Path) -> int:
    while True:
        try:
            handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except FileNotFoundError:
            raise MapError(f"{path}: its folder does not exist") from None
        except OSError as error:
            raise MapError(
                f"{path}: cannot be written here ({error.strerror}): give another place with -o"
            ) from None
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise MapError(
                f"{path}: another mapmyworld is writing this map: wait for it, or give another -o"
            ) from None
        except OSError as error:
            os.close(handle)
            raise MapError(
                f"{path}: its disk keeps no locks ({error.strerror}): give another place with -o"
            ) from None
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), lock.stat()):
                return handle
        os.close(handle)  # removed by its last holder between our two steps
