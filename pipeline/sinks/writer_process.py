"""Writing in a separate process, which measures and writes frames while the next ones are solved.

A thread would share the interpreter's lock with the solver, and both make many short calls: at 10 000 cells a thread
took half again as long as the longer of the two. Frames wait in a pipe between the processes; answers come back.
"""

import pickle
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from operator import attrgetter
from traceback import format_exception
from typing import Any

from pipeline.arrays import Ints
from pipeline.errors import OutputError, shorten
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.run.frame import Frame, Sink
from pipeline.run.recording import OnFrame, Recording, RunSummary
from pipeline.system.channel import Channel
from pipeline.system.child import ChildProcess

# cells: below this, handing a frame over costs the solver more than writing it (measured from 192 on)
WORTH_A_PROCESS = 1000
_SENT_FIELDS = ("index", "time", "x", "step", "v", "known", "work")  # of each frame; the mesh is sent once, before
_get_fields = attrgetter(*_SENT_FIELDS)
_PATIENCE = 10.0  # [s] for an idle process to end


class WriterProcess:
    """A process that records one run after another; it starts with the first one and ends with `close`.

    If the parent ends in any other way, this process ends after the frame under way. It keeps the descriptor `keep`
    open as long as it lives: a lock held through it outlives the parent until nothing more is written.
    """

    def __init__(self, *, keep: int | None = None) -> None:
        self._keep = keep
        self._child: ChildProcess | None = None

    def start_recording(
        self, sinks: Sequence[Sink], *, on_frame: OnFrame | None = None, before: RunSummary | None = None
    ) -> "RemoteRecording":
        """Return a Recording that measures and writes in the process; raises OutputError if none can start."""
        if self._child is not None and not self._child.is_alive():
            self.close()
        if self._child is None:
            name = "the process that writes frames"
            self._child = ChildProcess(f"{__name__}:record_runs", name=name, keep=self._keep)
        return RemoteRecording(self._child, sinks, on_frame=on_frame, before=before)

    def close(self) -> None:
        """End the process; nothing is written after this call, even if it is interrupted."""
        if self._child is not None:
            child, self._child = self._child, None
            child.close(patience=_PATIENCE)

    def __enter__(self) -> "WriterProcess":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class RemoteRecording:
    """One run recorded in a WriterProcess; `summary` and the calls of `on_frame` follow the frames written there.

    The first failure is raised by the next take, drain or close. `on_frame` is called from a thread.
    """

    def __init__(
        self,
        child: ChildProcess,
        sinks: Sequence[Sink],
        *,
        on_frame: OnFrame | None,
        before: RunSummary | None,
    ) -> None:
        self.summary = before or Recording(()).summary
        self._child, self._opening, self._on_frame = child, (tuple(sinks), before), on_frame
        self._began, self._earlier = 0.0, self.summary.wall_seconds
        self._waiting: deque[Frame] = deque()  # taken, not yet written
        self._failure: BaseException | None = None
        self._failed = self._closed = self._sending = False
        self._answered = threading.Condition()
        self._listener: threading.Thread | None = None

    def take(self, frame: Frame) -> None:
        """Send one frame, as soon as there is room; raises the failure of an earlier one."""
        self._raise_failure()
        if self._listener is None:
            self._began = time.perf_counter()
            self._listener = threading.Thread(target=self._listen, name="answers", daemon=True)
            self._listener.start()
            self._send((*self._opening, frame.mesh, frame.materials))
        with self._answered:
            self._waiting.append(frame)
        self._send(_get_fields(frame))

    def drain(self) -> None:
        """Wait until every frame taken is written; raises the failure of one of them."""
        with self._answered:
            self._answered.wait_for(lambda: self._failed or not self._waiting)
        self._raise_failure()

    def close(self) -> None:
        """Wait until the remaining frames are written and every sink is closed; raises the first failure."""
        if self._listener is not None:
            if self._sending:  # interrupted by a signal: the process would not understand another message
                self._failed = True
                self._child.kill()
            self._send(None)
            self._listener.join()
            self._listener = None
            self.summary = self._set_wall_time(self.summary)
        self._raise_failure()

    def _send(self, message: object) -> None:
        """Send a message; if the process has ended, the listener reports it."""
        self._sending = True
        with suppress(BrokenPipeError):
            self._child.send(message)
        self._sending = False

    def _listen(self) -> None:
        """Take answers until the last one; after a failure they have no effect."""
        while not self._closed:
            try:
                kind, content = self._child.receive()
            except Exception as error:
                self._fail(self._explain_end(error))
                self._closed = True
                return
            try:
                self._take_answer(kind, content)
            except BaseException as error:  # raised by on_frame: raised again where it can stop the run
                self._fail(error)

    def _explain_end(self, error: Exception) -> OutputError:
        """Return the failure to report if there are no more answers; ends the process if it has not ended."""
        if not isinstance(error, EOFError):  # otherwise the process would block on a full pipe
            self._child.kill()
            self._child.wait()
            return OutputError(f"the answers of the process that writes frames make no sense ({shorten(str(error))})")
        code = self._child.wait()
        remedy = "; out of memory?" if code == -9 else ""  # SIGKILL, the system's last resort
        return OutputError(f"the process that writes frames ended unexpectedly (exit code {code}{remedy})")

    def _take_answer(self, kind: str, content: Any) -> None:
        if kind == "failed":
            self._fail(content)
        else:
            self.summary = self._set_wall_time(content)
            self._closed = kind == "closed"
        if kind == "written":
            if self._on_frame is not None and not self._failed:
                self._on_frame(self._waiting[0], self.summary)
            with self._answered:  # last: after drain() the calls of on_frame are done
                self._waiting.popleft()
                self._answered.notify_all()

    def _fail(self, error: BaseException) -> None:
        with self._answered:
            if not self._failed:
                self._failure, self._failed = error, True
            self._answered.notify_all()

    def _set_wall_time(self, summary: RunSummary) -> RunSummary:
        """Return the summary with the wall time of this process."""
        return replace(summary, wall_seconds=self._earlier + time.perf_counter() - self._began)

    def _raise_failure(self) -> None:
        """Raise the failure, once."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure


def record_runs(channel: Channel) -> None:
    """Record one run after another: the life of a WriterProcess, which ends when its parent closes the channel."""
    with suppress(EOFError, BrokenPipeError, pickle.UnpicklingError):  # the parent has ended
        while True:
            _record_run(channel, *channel.receive())


def _record_run(
    channel: Channel, sinks: Sequence[Sink], before: RunSummary | None, mesh: BodyMesh, materials: Ints | None
) -> None:
    """Record one run; frames after a failure have no effect. The sinks are closed even if the channel ends early."""
    recording, has_failed = Recording(sinks, before=before), False
    try:
        while (fields := channel.receive()) is not None:
            if not has_failed:
                try:
                    recording.take(
                        Frame(mesh=mesh, materials=materials, **dict(zip(_SENT_FIELDS, fields, strict=True)))
                    )
                    channel.send(("written", recording.summary))
                except BrokenPipeError:
                    raise
                except Exception as error:
                    has_failed = True
                    channel.send(("failed", _make_portable(error)))
    finally:
        try:
            recording.close()
        except Exception as error:
            channel.send(("failed", _make_portable(error)))
    channel.send(("closed", recording.summary))


def _make_portable(error: Exception) -> Exception:
    """Return an error that another process can raise, with its traceback unless it is one of ours."""
    if not isinstance(error, OutputError):
        error.add_note("".join(format_exception(error)))
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return OutputError(f"{type(error).__name__}: {error}")
    return error
