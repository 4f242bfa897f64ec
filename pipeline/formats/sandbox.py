"""Reads files in a child process, within limits of memory and time: a reader that crashes takes nothing else down.

VTK's readers crash the whole process on many damaged files. One child reads file after file; after a crash a new one is
started. Its answers may contain only numbers and text, whatever a damaged file has done to it.
"""

import atexit
import os
import signal
from contextlib import suppress
from pathlib import Path
from threading import RLock, Timer
from typing import Any

from pipeline import errors
from pipeline.errors import OutputError, PipelineError
from pipeline.system.child import ChildProcess

GIGABYTES = "PIPELINE_READER_GIGABYTES"  # environment variable: memory for a file, if the default is too small
# a file of 1 M tetrahedra with 20 fields takes about 1 GB to read; compressed files take many times their size
_LEAST_BYTES, _BYTES_PER_BYTE = 2 * 10**9, 40
_LEAST_SECONDS, _BYTES_PER_SECOND = 20.0, 10**6
_SPREAD = frozenset({".xdmf", ".xmf", ".case", ".encas", ".foam", ".bp", "d3plot"})  # their numbers are in other files


class Reader:
    """One child process that reads files: started when it is needed, and again if it has died."""

    _child: ChildProcess | None

    def __init__(self) -> None:
        self.forget()

    def read(self, function: str, file: Path, *arguments: object, error: type[PipelineError]) -> Any:
        """Return function(file, *arguments), called in the child; `function` is "module:name".

        A PipelineError from the function is raised here. `error` is raised if the function raises anything else, the
        child dies, or reading takes too much memory or time.
        """
        path = file.absolute()  # the child may have been started in another folder
        size = _measure_files(path)
        memory, seconds = _memory_limit(size), _LEAST_SECONDS + size / _BYTES_PER_SECOND
        with self._lock:
            kind, answer = self._ask((function, (path, *arguments), memory, seconds), file, error)
        if not kind:
            return answer
        answer = answer.replace(str(path), str(file))
        if kind == "MemoryError":
            raise error(
                f"{file}: reading it takes more than {memory / 1e9:.3g} GB of memory; raise {GIGABYTES} to allow more"
            )
        if kind == "Exception":
            raise error(f"{file}: cannot be read ({' '.join(answer.split())[:300]})")
        raise getattr(errors, kind)(answer)

    def _ask(self, request: tuple[Any, ...], file: Path, error: type[PipelineError]) -> tuple[str, Any]:
        """Return the child's answer; raises `error` if there is none."""
        child = self._start(file, error)
        seconds = request[-1]
        timer = Timer(seconds, child.kill)
        timer.daemon = True
        timer.start()
        try:
            child.send(request)
            answer: tuple[str, Any] = child.receive(trusted=False)
            return answer
        except (EOFError, BrokenPipeError) as end:
            reason = _explain_exit(child.wait(), request[2], seconds)
            raise error(f"{file}: {reason}") from end
        except BaseException as failure:  # part of an answer may still be on its way
            self.close()
            if isinstance(failure, KeyboardInterrupt | SystemExit):
                raise
            raise error(f"{file}: the reader's answer makes no sense ({failure})") from failure
        finally:
            timer.cancel()

    def _start(self, file: Path, error: type[PipelineError]) -> ChildProcess:
        """Return the child, a new one unless it is alive."""
        if self._child is None or not self._child.is_alive():
            self.close()
            try:
                self._child = ChildProcess(
                    "pipeline.formats.sandbox_child:answer_requests", name="the reader", quiet=True
                )
            except OutputError as failure:
                raise error(f"{file}: {failure}") from failure
        return self._child

    def close(self) -> None:
        """End the child."""
        child, self._child = self._child, None
        if child is not None:
            child.close()

    def forget(self) -> None:
        """Start without a child: after a fork it stays with the parent, as two must not share it."""
        self._child = None
        self._lock = RLock()


def _share(reader: Reader) -> Reader:
    """Return a reader for the whole process: its child ends with it, and a forked process starts without the child."""
    atexit.register(reader.close)
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=reader.forget)
    return reader


SHARED_READER = _share(Reader())


def _measure_files(path: Path) -> int:
    """Return how many bytes reading a file may concern: also those of files beside it that hold its numbers."""
    if path.is_file() and path.suffix.lower() not in _SPREAD and path.name not in _SPREAD:
        return path.stat().st_size
    if not path.exists():
        return 0
    folder = path if path.is_dir() else path.parent
    deep = path.is_dir() or path.suffix.lower() in (".foam", ".case")
    try:
        # perhaps only some of them are read
        return (
            path.stat().st_size
            + sum(file.stat().st_size for file in (folder.rglob("*") if deep else folder.iterdir()) if file.is_file())
            // 5
        )
    except OSError:  # files that vanish meanwhile
        return path.stat().st_size


def _memory_limit(size: int) -> int:
    """Return how many bytes reading a file of that size may take."""
    with suppress(KeyError, ValueError):
        return int(float(os.environ[GIGABYTES]) * 1e9)
    return max(_LEAST_BYTES, _BYTES_PER_BYTE * size)


def _explain_exit(code: int, memory: int, seconds: float) -> str:
    """Return why a child ended, by its exit code."""
    if code >= 0:
        return f"the reader ended with exit code {code}"
    if code in (-signal.SIGKILL, -getattr(signal, "SIGXCPU", 0)):
        return f"the reader was killed: it took longer than {seconds:.0f} s, or ran out of memory"
    name = signal.Signals(-code).name
    return (
        f"the reader died ({name}): the file is damaged, or takes more than {memory / 1e9:.3g} GB of memory "
        f"(raise {GIGABYTES} to allow more)"
    )
