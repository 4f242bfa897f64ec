"""Starts Python processes with this one's sys.path, on one thread, and with a message channel to each."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from pipeline.errors import OutputError
from pipeline.system.channel import ASKING_TO_END, BEGIN, Channel
from pipeline.system.threads import make_thread_environment

_PIPE_BYTES = 1 << 20  # for waiting messages; the most that Linux gives to any user


def make_command(code: str, *arguments: str) -> list[str]:
    """Return the command of a Python process that runs `code` with the sys.path of this one.

    The working folder is not searched unless it is in sys.path: a file there may have the name of any module.
    """
    paths = [path for path in sys.path if isinstance(path, str)]  # Python ignores other entries
    start = f"import sys; sys.path[:] = {paths!r}\n"
    return [sys.executable, "-P", "-c", start + code, *arguments]


class ChildProcess:
    """A Python process that runs the function "module:name" with a Channel to this one.

    The child ignores both signals that ask it to end, from its very start: this process decides when to end it.
    `keep` is a descriptor that stays open as long as the child lives. A `quiet` child's standard error is discarded.
    Raises OutputError if the process, `name` in messages, cannot be started.
    """

    def __init__(self, function: str, *, name: str, keep: int | None = None, quiet: bool = False) -> None:
        code = f"from {Channel.__module__} import serve; serve({function!r})"
        try:
            with _block_signals():
                self.process = subprocess.Popen(
                    make_command(code),
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL if quiet else None,
                    env=os.environ | make_thread_environment(1),  # BLAS reserves gigabytes of address space for threads
                    pass_fds=() if keep is None or os.name != "posix" else (keep,),
                )
        except OSError as error:
            raise OutputError(f"{name} cannot be started ({error.strerror or error})") from error
        assert self.process.stdin is not None and self.process.stdout is not None
        self._requests, self._answers = self.process.stdin, self.process.stdout
        with suppress(ImportError, AttributeError, OSError):  # only on Linux; other systems keep their 64 kB
            import fcntl

            fcntl.fcntl(self._requests, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        self._channel = Channel(self._answers, self._requests.fileno())
        self._has_begun = False

    def is_alive(self) -> bool:
        """Return whether the process is still running."""
        return self.process.poll() is None

    def send(self, message: object) -> None:
        """Send a message; raises BrokenPipeError if the process has ended."""
        self._channel.send(message)

    def receive(self, *, trusted: bool = True) -> Any:
        """Return the next message of the process; errors are those of Channel.receive."""
        while not self._has_begun:
            line = self._answers.readline()
            if not line:
                raise EOFError
            self._has_begun = line.endswith(BEGIN)
        return self._channel.receive(trusted=trusted)

    def kill(self) -> None:
        """End the process at once; close() is still needed."""
        self.process.kill()

    def wait(self) -> int:
        """Return the exit code, negative for a signal, when the process has ended."""
        return self.process.wait()

    def close(self, *, patience: float = 0.0) -> None:
        """Close the channel, which ends the process after its current work; kill it after `patience` [s]."""
        try:
            with suppress(OSError):
                self._requests.close()
            if patience:
                with suppress(subprocess.TimeoutExpired):
                    self.process.wait(patience)
        finally:  # even if the wait is interrupted, so that the process does nothing after this call
            self.process.kill()
            self.process.wait()
            self._answers.close()


@contextmanager
def _block_signals() -> Iterator[None]:
    """Block the signals that ask for an end, so that a process started here never gets them, not even at its start."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ASKING_TO_END)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
