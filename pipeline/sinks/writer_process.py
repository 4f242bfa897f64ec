"""Writing beside solving, in a process of its own: it measures and writes frames while the next ones are solved.

A thread would share the interpreter's lock with the solver, and both are many short calls: at 10 000 cells they took
half as long again as the longer of the two. Frames wait in a pipe between the two; answers come back.
"""

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from traceback import format_exception
from typing import IO, Any

from pipeline.errors import OutputError, shorten
from pipeline.mesh.simplex import Mesh
from pipeline.run.frame import Frame, Sink
from pipeline.run.recording import OnFrame, Recording, RunSummary

# cells: below, a frame costs the solver more to hand over than to write (measured from 192 on)
WORTH_A_PROCESS = 1000
_SENT = ("index", "time", "x", "step", "v", "known", "work")  # of a frame; its mesh goes before the first
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
# the paths of this process and no other: what lies in the working folder may have the name of any module
_SERVE = f"import sys; sys.path[:] = {{paths!r}}; from {__name__} import serve; serve()"
_ASKING = (signal.SIGINT, signal.SIGTERM)
_BEGIN = b"what follows are answers\n"  # what was printed while the process started comes before it
_PIPE = 1 << 20  # [bytes] as much as Linux gives anyone: frames that wait; a larger one waits with its solver
_PATIENCE = 10.0  # [s] for a process without work to end

Answer = Callable[[str, Any], None]


class WriterProcess:
    """A process that records one run after another; it starts with the first one and ends with `close`.

    It ends too, after the frame under way, when this process does, however that ends. `keep`, a descriptor, stays open
    as long as it lives: a lock held by it outlives this process until nothing more is written.
    """

    def __init__(self, *, keep: int | None = None) -> None:
        self._keep = keep
        self._process: subprocess.Popen[bytes] | None = None

    def recording(
        self, sinks: Sequence[Sink], *, on_frame: OnFrame | None = None, before: RunSummary | None = None
    ) -> "RemoteRecording":
        """Return what takes frames as Recording does, and records them there; raises OutputError if none can start."""
        if self._process is not None and self._process.poll() is not None:
            self.close()
        if self._process is None:
            self._process = _started(self._keep)
        return RemoteRecording(self._process, sinks, on_frame=on_frame, before=before)

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            process, self._process = self._process, None
            requests, answers = _pipes(process)
            try:
                with suppress(OSError):  # what it was sent half of does not matter any more
                    requests.close()
                process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                pass
            finally:  # also where who waits is interrupted: nothing is written once the folder is let go
                process.kill()
                process.wait()
                answers.close()

    def __enter__(self) -> "WriterProcess":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _started(keep: int | None) -> "subprocess.Popen[bytes]":
    paths = [path for path in sys.path if isinstance(path, str)]  # of all else Python takes no notice
    kept = () if keep is None or os.name != "posix" else (keep,)
    try:
        with _undisturbed():
            process = subprocess.Popen(
                [sys.executable, "-c", _SERVE.format(paths=paths)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=os.environ | _ONE_THREAD,
                pass_fds=kept,
            )
    except OSError as error:
        raise OutputError(f"the process that writes frames cannot be started ({error.strerror or error})") from error
    with suppress(ImportError, AttributeError, OSError):  # of Linux; elsewhere 64 kB have to do
        import fcntl

        fcntl.fcntl(_pipes(process)[0], fcntl.F_SETPIPE_SZ, _PIPE)
    return process


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Hold back what asks for an end: a process that is started here never gets it, from its first moment on."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ASKING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _pipes(process: "subprocess.Popen[bytes]") -> tuple[IO[bytes], IO[bytes]]:
    """Return where requests to a process go in, and its answers come out."""
    if process.stdin is None or process.stdout is None:
        raise ValueError("a process without pipes")
    return process.stdin, process.stdout


class RemoteRecording:
    """One run recorded in a WriterProcess; `summary`, and what `on_frame` is told, follow the frames written there.

    The first failure is raised by the next take, drain or close. `on_frame` is called from a thread.
    """

    def __init__(
        self,
        process: "subprocess.Popen[bytes]",
        sinks: Sequence[Sink],
        *,
        on_frame: OnFrame | None,
        before: RunSummary | None,
    ) -> None:
        self.summary = before or Recording(()).summary
        self._process, self._opening, self._on_frame = process, (tuple(sinks), before), on_frame
        self._requests, self._answers = _pipes(process)
        self._began, self._earlier = 0.0, self.summary.wall_seconds
        self._waiting: deque[Frame] = deque()  # taken, not answered
        self._failure: BaseException | None = None
        self._failed = self._closed = self._sending = False
        self._answered = threading.Condition()
        self._listener: threading.Thread | None = None

    def take(self, frame: Frame) -> None:
        """Send one frame, when there is room; raises what an earlier one failed with."""
        self._raise_failure()
        if self._listener is None:
            self._began = time.perf_counter()
            self._listener = threading.Thread(target=self._listen, name="answers", daemon=True)
            self._listener.start()
            self._send((*self._opening, frame.mesh))
        with self._answered:
            self._waiting.append(frame)
        self._send({name: getattr(frame, name) for name in _SENT})

    def drain(self) -> None:
        """Wait until every frame taken is written; raises what one of them failed with."""
        with self._answered:
            self._answered.wait_for(lambda: self._failed or not self._waiting)
        self._raise_failure()

    def close(self) -> None:
        """Have what is waiting written and every sink closed; raises the first failure."""
        if self._listener is not None:
            if self._sending:  # a signal came in between: what follows would not be understood
                self._failed = True
                self._process.kill()
            self._send(None)
            self._listener.join()
            self._listener = None
            self.summary = self._timed(self.summary)
        self._raise_failure()

    def _send(self, message: object) -> None:
        """Send a message; that the process has ended is told by who listens to it."""
        self._sending = True
        with suppress(BrokenPipeError):
            # in one piece: each write would wake up who reads
            self._requests.write(pickle.dumps(message, protocol=5))
            self._requests.flush()
        self._sending = False

    def _listen(self) -> None:
        """Take answers until the last one; after a failure they have no effect."""
        while (line := self._answers.readline()) and not line.endswith(_BEGIN):
            pass
        while not self._closed:
            try:
                kind, told = pickle.load(self._answers)
            except Exception as error:
                self._fail(self._ended(error))
                self._closed = True
                return
            try:
                self._take_answer(kind, told)
            except BaseException as error:  # of on_frame: raised again where it can stop the run
                self._fail(error)

    def _ended(self, error: Exception) -> OutputError:
        """Return what to say where there are no more answers: the process has ended, or it is ended here."""
        if not isinstance(error, EOFError):  # it would wait for who listens
            self._process.kill()
            self._process.wait()
            return OutputError(f"the answers of the process that writes frames make no sense ({shorten(str(error))})")
        code = self._process.wait()
        remedy = "; out of memory?" if code == -9 else ""  # SIGKILL, as the system's last resort
        return OutputError(f"the process that writes frames ended by itself (exit code {code}{remedy})")

    def _take_answer(self, kind: str, told: Any) -> None:
        if kind == "failed":
            self._fail(told)
        else:
            self.summary = self._timed(told)
            self._closed = kind == "closed"
        if kind == "written":
            if self._on_frame is not None and not self._failed:
                self._on_frame(self._waiting[0], self.summary)
            with self._answered:  # last: who drains may rely on what on_frame did
                self._waiting.popleft()
                self._answered.notify_all()

    def _fail(self, error: BaseException) -> None:
        with self._answered:
            if not self._failed:
                self._failure, self._failed = error, True
            self._answered.notify_all()

    def _timed(self, summary: RunSummary) -> RunSummary:
        """Return a summary whose wall time is that of who waits."""
        return replace(summary, wall_seconds=self._earlier + time.perf_counter() - self._began)

    def _raise_failure(self) -> None:
        """Raise what failed, once."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure


def _portable(error: Exception) -> Exception:
    """Return an error that another process can raise, with its traceback where it is none of ours."""
    if not isinstance(error, OutputError):
        error.add_note("".join(format_exception(error)))
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return OutputError(f"{type(error).__name__}: {error}")
    return error


def serve() -> None:
    """Record runs from stdin, answer to stdout: the life of a WriterProcess, which ends with its input.

    Who asks decides when to stop: signals that a terminal or a queue sends to all are left to it.
    """
    for number in _ASKING:
        signal.signal(number, signal.SIG_IGN)
    while (spare := os.open(os.devnull, os.O_RDWR)) <= 2:  # closed where it was started: answers took its number
        pass
    os.close(spare)
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # what a library prints is no answer

    def answer(kind: str, told: Any) -> None:
        answers.write(pickle.dumps((kind, told)))

    with answers, suppress(EOFError, BrokenPipeError, pickle.UnpicklingError):  # who asks is gone
        while True:
            opening = pickle.load(requests)
            answers.write(_BEGIN)
            _record(requests, answer, *opening)


def _record(requests: IO[bytes], answer: Answer, sinks: Sequence[Sink], before: RunSummary | None, mesh: Mesh) -> None:
    """Record one run; after a failure its frames have no effect. Where the input ends early, the sinks are closed."""
    recording, failed = Recording(sinks, before=before), False
    try:
        while (sent := pickle.load(requests)) is not None:
            if not failed:
                try:
                    recording.take(Frame(mesh=mesh, **sent))
                    answer("written", recording.summary)
                except BrokenPipeError:
                    raise
                except Exception as error:
                    failed = True
                    answer("failed", _portable(error))
    finally:
        try:
            recording.close()
        except Exception as error:
            answer("failed", _portable(error))
    answer("closed", recording.summary)
