"""The child process of the sandbox: reads one file after another, within limits of memory and time.

A request is (function, arguments, bytes and seconds that it may take); an answer is ("", result), or the name of an
error's class and its text.
"""

import sys
from importlib import import_module
from typing import Any

from pipeline.errors import PipelineError
from pipeline.system.channel import Channel


def answer_requests(channel: Channel) -> None:
    """Answer requests until there are no more."""
    while True:
        try:
            request = channel.receive()
        except EOFError:
            return
        channel.send(_answer(*request))


def _answer(function: str, arguments: tuple[Any, ...], memory: int, seconds: float) -> tuple[str, Any]:
    module, _, name = function.partition(":")
    try:
        called = getattr(import_module(module), name)
        _limit_process(memory, seconds)
        return "", called(*arguments)
    except PipelineError as error:
        return type(error).__name__, str(error)
    except MemoryError:
        return "MemoryError", ""
    except Exception as error:  # whatever a parser raises
        return "Exception", f"{type(error).__name__}: {error}"


def _limit_process(memory: int, seconds: float) -> None:
    """Allow this process this many more bytes and seconds than it has used so far."""
    if sys.platform == "win32":
        return
    import resource

    used = resource.getrusage(resource.RUSAGE_SELF)
    # the parent has a clock of its own; this limit ends a process whose parent has died
    end = int(used.ru_utime + used.ru_stime + seconds) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (end, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        with open("/proc/self/statm") as statm:
            taken = int(statm.read().split()[0]) * resource.getpagesize()
    except OSError:  # a system without /proc
        return
    resource.setrlimit(resource.RLIMIT_AS, (taken + memory, resource.RLIM_INFINITY))
