"""Writing beside solving: a bounded queue and one thread that measures and writes frames, in order.

What it does is arithmetic on whole arrays, compression and waiting for the disk, which leave the interpreter free for
the next step. For small meshes it is mostly the interpreter itself, and two threads only take it from each other.
"""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from queue import Queue

from pipeline.frame import Frame
from pipeline.run import Watcher

# enough to bridge one slow fsync; more would only take memory
WAITING_FRAMES = 4
# cells: measured, 192 take longer beside than one after the other, 10 000 two thirds of that
WORTH_A_THREAD = 1000
# [s] a thread that comes back from compiled code waits so long for the interpreter; with Python's 5 ms a solver of many
# short array operations and a writer of many short calls take as long together as one after the other
_TURN = 1e-4


@contextmanager
def short_turns() -> Iterator[None]:
    """Have threads give up the interpreter sooner."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(_TURN)
    try:
        yield
    finally:
        sys.setswitchinterval(before)


class Overlapped:
    """Hands frames on from a thread of its own; the first failure is raised by the next take, drain or close."""

    def __init__(self, watcher: Watcher, *, waiting: int = WAITING_FRAMES) -> None:
        self._watcher = watcher
        self._queue: Queue[Frame | None] = Queue(waiting)
        self._failure: BaseException | None = None
        self._failed = False
        self._thread: threading.Thread | None = None

    def take(self, frame: Frame) -> None:
        """Take one frame, when there is room; raises what an earlier one failed with."""
        self._raise_failure()
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="writer", daemon=True)
            self._thread.start()
        self._queue.put(frame)

    def drain(self) -> None:
        """Wait until every frame taken is written; raises what one of them failed with."""
        self._queue.join()
        self._raise_failure()

    def close(self) -> None:
        """Write what is waiting, end the thread and close the watcher; raises the first failure."""
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join()
            self._thread = None
        try:
            self._watcher.close()
        except Exception as error:
            self._failure = self._failure or error
        self._raise_failure()

    def _work(self) -> None:
        """Hand frames on until None comes; after a failure take them without effect: nobody waits for ever."""
        while (frame := self._queue.get()) is not None:
            try:
                if not self._failed:
                    self._watcher.take(frame)
            except BaseException as error:  # raised again where it can stop the run
                self._failure, self._failed = error, True
            self._queue.task_done()

    def _raise_failure(self) -> None:
        """Raise what failed, once."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure
