"""A bounded queue of frames and one thread that hands them on, in order: who takes them need not wait for each."""

import threading
from queue import Queue

from pipeline.frame import Frame
from pipeline.run import Watcher

# enough to bridge one slow fsync; more would only take memory
WAITING_FRAMES = 4


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
