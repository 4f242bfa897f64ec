"""The child process that reads files: takes requests on standard input, answers on standard output, until that closes.

A request is a pickle (function, arguments, bytes and seconds that it may take). An answer is a pickle and the bytes of
the arrays in it, each after its length. Whatever a reader prints goes nowhere.
"""

import os
import pickle
import signal
import struct
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import IO, Any

from pipeline.errors import PipelineError

COUNT = struct.Struct("<Q")


def serve() -> None:
    """Answer requests until there are no more."""
    answers = os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to answer
    while size := sys.stdin.buffer.read(COUNT.size):
        request = pickle.loads(sys.stdin.buffer.read(COUNT.unpack(size)[0]))
        send(answers, _answer(*request))


def send(stream: IO[bytes], content: object) -> None:
    """Write one object, the bytes of its arrays not copied."""
    buffers: list[pickle.PickleBuffer] = []
    parts: Sequence[Any] = [pickle.dumps(content, protocol=5, buffer_callback=buffers.append)]
    parts = [*parts, *(buffer.raw() for buffer in buffers)]
    stream.write(COUNT.pack(len(parts)) + b"".join(COUNT.pack(len(part)) for part in parts))
    for part in parts:
        stream.write(part)
    stream.flush()


def _answer(function: str, arguments: tuple[Any, ...], memory: int, seconds: float) -> tuple[str, Any]:
    """Return ("", result), or the name of an error's class and what it says."""
    module, _, name = function.partition(":")
    try:
        called = getattr(import_module(module), name)
        _limit(memory, seconds)
        return "", called(*arguments)
    except PipelineError as error:
        return type(error).__name__, str(error)
    except MemoryError:
        return "MemoryError", ""
    except Exception as error:  # a parser's own: whatever it stumbled on
        return "Exception", f"{type(error).__name__}: {error}"


def _limit(memory: int, seconds: float) -> None:
    """Allow this process so many bytes and seconds more than it has taken."""
    if sys.platform == "win32":
        return
    import resource

    used = resource.getrusage(resource.RUSAGE_SELF)
    # whoever started this process stops the clock; this one is for a process whose parent is gone
    end = int(used.ru_utime + used.ru_stime + seconds) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (end, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        with open("/proc/self/statm") as statm:
            taken = int(statm.read().split()[0]) * resource.getpagesize()
    except OSError:  # a system without /proc
        return
    resource.setrlimit(resource.RLIMIT_AS, (taken + memory, resource.RLIM_INFINITY))
