"""Messages between two Python processes: one format for all of them, and the child's end.

A message is a mark, the number of its parts, their lengths, and the parts: a protocol-5 pickle and the bytes of its
arrays, which are copied only if they are small.
"""

import io
import os
import pickle
import signal
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import IO, Any

ASKING_TO_END = (signal.SIGINT, signal.SIGTERM)  # terminals and batch queues send them to every process of a run
BEGIN = b"messages follow\n"  # comes after anything that Python prints while the child starts
_MARK = b"MSG\n"  # exposes stray bytes at once; read as a length, they would make the reader wait
_HEAD = struct.Struct("<4sI")  # mark, number of parts
_SMALL = 1 << 16  # bytes: joining a smaller message is faster than writing it in parts
_MOST_PARTS = 1000  # per call; Linux accepts 1024


class Channel:
    """Sends messages to a descriptor and receives them from a buffered stream."""

    def __init__(self, incoming: IO[bytes], outgoing: int) -> None:
        self._incoming, self._outgoing = incoming, outgoing

    def send(self, message: object) -> None:
        """Write a message, waiting for room if necessary; raises BrokenPipeError if the other process has ended."""
        buffers: list[pickle.PickleBuffer] = []
        content = pickle.dumps(message, protocol=5, buffer_callback=buffers.append)
        parts = [memoryview(content), *[buffer.raw() for buffer in buffers]]
        sizes = [len(part) for part in parts]
        head = _HEAD.pack(_MARK, len(sizes)) + struct.pack(f"<{len(sizes)}Q", *sizes)
        if sum(sizes) < _SMALL:
            _write(self._outgoing, [memoryview(b"".join([head, *parts]))])
        else:
            _write(self._outgoing, [memoryview(head), *parts])

    def receive(self, *, trusted: bool = True) -> Any:
        """Return the next message; raises EOFError if there is none, another error if the bytes are not a message.

        A message that is not `trusted` may contain only arrays, numbers, strings and containers of these.
        """
        mark, count = _HEAD.unpack(self._read(_HEAD.size))
        if mark != _MARK:
            raise pickle.UnpicklingError("no message")
        sizes = struct.unpack(f"<{count}Q", self._read(8 * count))
        content, *buffers = [self._read(size) for size in sizes]
        unpickler = pickle.Unpickler if trusted else _ArrayUnpickler
        return unpickler(io.BytesIO(content), buffers=buffers).load()

    def _read(self, size: int) -> bytearray:
        content = bytearray(size)
        view, filled = memoryview(content), 0
        while filled < size:
            count = self._incoming.readinto(view[filled:])  # type: ignore[attr-defined]  # binary streams have it
            if not count:
                raise EOFError
            filled += count
        return content


def _write(descriptor: int, parts: list[memoryview]) -> None:
    """Write all parts in as few calls as the system allows: each call wakes the reader."""
    while parts:
        if len(parts) > 1 and hasattr(os, "writev"):
            written = os.writev(descriptor, parts[:_MOST_PARTS])
        else:
            written = os.write(descriptor, parts[0])
        while parts and written >= len(parts[0]):
            written -= len(parts.pop(0))
        if written:
            parts[0] = parts[0][written:]


class _ArrayUnpickler(pickle.Unpickler):
    """Builds arrays and Python's numbers, strings and containers; calls nothing else that a pickle names."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ARRAYS:
            raise pickle.UnpicklingError(f"{module}.{name} is not an array")
        return super().find_class(module, name)


_ARRAYS = {
    ("numpy", "dtype"),
    ("numpy", "ndarray"),
    ("numpy._core.numeric", "_frombuffer"),
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"),
}


def serve(function: str) -> None:
    """Call the function "module:name" in a child process with a Channel to the parent.

    The parent decides when to end: signals sent to every process are ignored. Anything printed goes to standard error.
    """
    for number in ASKING_TO_END:
        signal.signal(number, signal.SIG_IGN)
    # if standard streams are closed, the copy of standard output could become standard error and receive its text
    while (spare := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(spare)
    outgoing = os.dup(1)
    os.dup2(2, 1)
    module, _, name = function.partition(":")
    called: Callable[[Channel], None] = getattr(import_module(module), name)
    with suppress(BrokenPipeError):
        os.write(outgoing, BEGIN)
        called(Channel(sys.stdin.buffer, outgoing))
