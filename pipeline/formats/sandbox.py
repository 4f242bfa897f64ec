"""Reading in a child process, within limits of memory and time: a reader that dies takes nothing along.

VTK's readers end the whole process on many a damaged file. One child reads file after file; after a death there is
a new one. What it answers is made of numbers and texts only, whatever became of it.
"""

import atexit
import io
import os
import pickle
import signal
import subprocess
import sys
from contextlib import suppress
from io import BufferedIOBase
from pathlib import Path
from threading import RLock, Timer
from typing import Any, cast

from pipeline import errors
from pipeline.errors import PipelineError
from pipeline.formats.sandbox_child import COUNT

GIGABYTES = "PIPELINE_READER_GIGABYTES"  # of the environment: what a file may take where the default is too little
# a file of 1 M tetrahedra with 20 fields takes about 1 GB to read; compressed ones are read into many times their size
_LEAST_BYTES, _BYTES_PER_BYTE = 2 * 10**9, 40
_LEAST_SECONDS, _BYTES_PER_SECOND = 20.0, 10**6
# the package without its __init__: the child reads files only, and shall start fast
_START = """
import sys, types
sys.path[:] = {paths!r}
package = types.ModuleType("pipeline")
package.__path__ = [{package!r}]
sys.modules["pipeline"] = package
from pipeline.formats.sandbox_child import serve
serve()
"""


class Reader:
    """One child process that reads files for this one: started when it is needed, and again after it died."""

    _process: subprocess.Popen[bytes] | None

    def __init__(self) -> None:
        self.forget()

    def read(self, function: str, file: Path, *arguments: object, error: type[PipelineError]) -> Any:
        """Return function(file, *arguments), called in the child; `function` is "module:name".

        What the function raises on purpose is raised here. `error` is raised where it raises anything else, where
        the child dies, and where it takes too much memory or time.
        """
        whole = file.absolute()  # the child may have been started in another folder
        size = whole.stat().st_size if whole.exists() else 0
        memory, seconds = _memory(size), _LEAST_SECONDS + size / _BYTES_PER_SECOND
        with self._lock:
            kind, answer = self._asked((function, (whole, *arguments), memory, seconds), file, error)
        if not kind:
            return answer
        answer = answer.replace(str(whole), str(file))
        if kind == "MemoryError":
            raise error(f"{file}: reading it takes more than {memory / 1e9:.3g} GB of memory; {GIGABYTES} allows more")
        if kind == "Exception":
            raise error(f"{file}: cannot be read ({' '.join(answer.split())[:300]})")
        raise getattr(errors, kind)(answer)

    def _asked(self, request: tuple[Any, ...], file: Path, error: type[PipelineError]) -> tuple[str, Any]:
        """Return the child's answer; raises `error` where there is none."""
        child = self._started()
        assert child.stdin is not None and child.stdout is not None
        seconds = request[-1]
        timer = Timer(seconds, child.kill)
        timer.daemon = True
        timer.start()
        try:
            data = pickle.dumps(request)
            child.stdin.write(COUNT.pack(len(data)) + data)
            child.stdin.flush()
            return _received(cast(BufferedIOBase, child.stdout))
        except (EOFError, BrokenPipeError) as gone:
            why = _last_words(child.wait(), request[2], seconds)
            raise error(f"{file}: {why}") from gone
        except BaseException as broken:  # half an answer may be under way
            self.close()
            if isinstance(broken, KeyboardInterrupt | SystemExit):
                raise
            raise error(f"{file}: the reader's answer makes no sense ({broken})") from broken
        finally:
            timer.cancel()

    def _started(self) -> subprocess.Popen[bytes]:
        """Return the child, a new one where there is none alive."""
        if self._process is not None and self._process.poll() is None:
            return self._process
        self.close()
        paths = [path for path in sys.path if isinstance(path, str)]  # of all else Python takes no notice
        code = _START.format(paths=paths, package=str(Path(__file__).resolve().parent.parent))
        self._process = subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            # threads of BLAS take addresses by the gigabyte
            env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        return self._process

    def close(self) -> None:
        """End the child."""
        child, self._process = self._process, None
        if child is None:
            return
        child.kill()
        for stream in (child.stdin, child.stdout):
            with suppress(OSError):  # what was not sent to one that died
                if stream is not None:
                    stream.close()
        child.wait()

    def forget(self) -> None:
        """Begin without a child; one that there is stays with who started it: after a fork two could ask it."""
        self._process = None
        self._lock = RLock()


READER = Reader()
atexit.register(READER.close)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=READER.forget)


def _memory(size: int) -> int:
    """Return how many bytes reading a file of that size may take."""
    with suppress(KeyError, ValueError):
        return int(float(os.environ[GIGABYTES]) * 1e9)
    return max(_LEAST_BYTES, _BYTES_PER_BYTE * size)


def _last_words(code: int, memory: int, seconds: float) -> str:
    """Return why a child ended, by its exit code."""
    if code >= 0:
        return f"the reader ended with exit code {code}"
    if code in (-signal.SIGKILL, -getattr(signal, "SIGXCPU", 0)):
        return f"the reader was killed: it took longer than {seconds:.0f} s, or the memory did not suffice"
    name = signal.Signals(-code).name
    return (
        f"the reader died ({name}): the file is damaged, or takes more than {memory / 1e9:.3g} GB of memory "
        f"({GIGABYTES} allows more)"
    )


def _received(stream: BufferedIOBase) -> tuple[str, Any]:
    """Return one object that server.send wrote; raises EOFError where it ends too early."""
    (count,) = COUNT.unpack(_exactly(stream, COUNT.size))
    sizes = [COUNT.unpack(_exactly(stream, COUNT.size))[0] for _ in range(count)]
    content, *buffers = [_exactly(stream, size) for size in sizes]
    answer: tuple[str, Any] = _Plain(io.BytesIO(content), buffers=buffers).load()
    return answer


def _exactly(stream: BufferedIOBase, size: int) -> bytearray:
    out = bytearray(size)
    view, filled = memoryview(out), 0
    while filled < size:
        got = stream.readinto(view[filled:])
        if not got:
            raise EOFError
        filled += got
    return out


class _Plain(pickle.Unpickler):
    """Makes arrays, and of what Python has only numbers, texts and containers of them."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ARRAYS:
            raise pickle.UnpicklingError(f"{module}.{name} is no array")
        return super().find_class(module, name)


_ARRAYS = {
    ("numpy", "dtype"),
    ("numpy", "ndarray"),
    ("numpy._core.numeric", "_frombuffer"),
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"),
}
