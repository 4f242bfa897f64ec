"""One run at a time in a result folder."""

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pipeline.errors import CaseError, OutputError

LOCK = ".lock"
_WAIT_SECONDS = 2.0  # the writer process outlives a killed run by a moment
_LAST_STREAM = 2  # a child process has its own standard streams in these descriptors


@contextmanager
def lock_folder(folder: Path) -> Iterator[int]:
    """Lock the folder against every other run; the system releases it when this process ends, however it does.

    Yields the descriptor of the lock: a process that inherits it also holds the folder.

    Raises CaseError if another run holds it, OutputError if the lock file cannot be created. On a file system without
    locks, nothing is locked.
    """
    path = folder / LOCK
    descriptor = _acquire(path)
    try:
        yield descriptor
    finally:
        # removed while it is held: another run that has opened it finds that the file no longer has that name
        if _is_open_file(descriptor, path):
            with suppress(OSError):  # Windows does not remove open files
                path.unlink()
        os.close(descriptor)


def _acquire(path: Path) -> int:
    """Return the descriptor of the locked lock file; waits a moment for the current holder to end."""
    deadline = time.monotonic() + _WAIT_SECONDS
    while True:
        descriptor = _open_lock_file(path)
        try:
            if _try_lock(descriptor, path):
                return descriptor
        except CaseError:
            if time.monotonic() > deadline:
                os.close(descriptor)
                raise
            time.sleep(0.02)
        os.close(descriptor)


def _open_lock_file(path: Path) -> int:
    """Return a descriptor of the lock file above those of the standard streams; raises OutputError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, low = os.open(path, os.O_RDWR | os.O_CREAT, 0o644), []
    except (FileExistsError, NotADirectoryError) as error:
        raise OutputError(f"{path}: part of this path is a file, not a folder") from error
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror})") from error
    while descriptor <= _LAST_STREAM:
        low.append(descriptor)
        descriptor = os.dup(descriptor)
    for number in low:
        os.close(number)
    return descriptor


def _try_lock(descriptor: int, path: Path) -> bool:
    """Return whether we hold the lock and the file still has that name; raises CaseError if another run holds it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError) as error:
        raise CaseError(f"{path.parent}: another run is writing to it; wait for it or use --out") from error
    except OSError:  # a file system without locks
        return True
    return _is_open_file(descriptor, path)


def _is_open_file(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except OSError:
        return False
