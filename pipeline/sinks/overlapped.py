"""Writing beside solving: a bounded queue and one thread that hands frames to other sinks, in order.

What writing takes is compression and waiting for the disk, which leave the interpreter free for the next step.
"""

import threading
import time
from collections.abc import Sequence
from queue import Queue

from pipeline.frame import Frame, Sink, Values

# enough to bridge one slow fsync; more would only take memory
WAITING_FRAMES = 4


class Overlapped:
    """Writes into `sinks` on a thread of its own; the first failure is raised by the next write, drain or close."""

    def __init__(self, sinks: Sequence[Sink], *, waiting: int = WAITING_FRAMES) -> None:
        self._sinks = tuple(sinks)
        self._queue: Queue[tuple[Frame, Values] | None] = Queue(waiting)
        self._failure: BaseException | None = None
        self._failed = False
        self._busy = self._waited = 0.0
        self._thread: threading.Thread | None = None

    @property
    def hidden_seconds(self) -> float:
        """Return the seconds of writing that the caller did not wait for."""
        return max(self._busy - self._waited, 0.0)

    def write(self, frame: Frame, measured: Values) -> None:
        """Take one frame, when there is room; raises what an earlier one failed with."""
        self._raise_failure()
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="writer", daemon=True)
            self._thread.start()
        began = time.perf_counter()
        self._queue.put((frame, measured))
        self._waited += time.perf_counter() - began

    def drain(self) -> None:
        """Wait until every frame taken is written; raises what one of them failed with."""
        began = time.perf_counter()
        self._queue.join()
        self._waited += time.perf_counter() - began
        self._raise_failure()

    def close(self) -> None:
        """Write what is waiting, end the thread and close the sinks; raises the first failure."""
        began = time.perf_counter()
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join()
            self._thread = None
        self._waited += time.perf_counter() - began
        for sink in self._sinks:
            try:
                sink.close()
            except Exception as error:
                self._failure = self._failure or error
        self._raise_failure()

    def _work(self) -> None:
        """Write frames until None comes; after a failure take them without effect, so that nobody waits for ever."""
        while (taken := self._queue.get()) is not None:
            began = time.perf_counter()
            try:
                for sink in self._sinks if not self._failed else ():
                    sink.write(*taken)
            except BaseException as error:  # raised again where it can stop the run
                self._failure, self._failed = error, True
            self._busy += time.perf_counter() - began
            self._queue.task_done()

    def _raise_failure(self) -> None:
        """Raise what the writer failed with, once."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure
