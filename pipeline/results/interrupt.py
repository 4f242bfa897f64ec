"""Interruptions on request: SIGINT and SIGTERM let the current step finish."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any


class Interrupted(KeyboardInterrupt):
    """A run stopped at the user's request; the message says where, and how to continue."""

    def __init__(self, place: str) -> None:
        super().__init__(f"interrupted after {place}; the same command with --resume continues from there")


@dataclass
class InterruptRequest:
    """Whether a signal requested an end; while `solving`, the run finishes its step first, else it ends at once."""

    requested: bool = False
    solving: bool = False

    def request(self, *_: Any) -> None:
        """Record the request; the second time, or outside a step, interrupt at once."""
        if self.requested or not self.solving:
            raise KeyboardInterrupt
        self.requested = True


@contextmanager
def catch_interrupts() -> Iterator[InterruptRequest]:
    """Yield the request, which SIGINT and SIGTERM set in the main thread unless they are ignored."""
    request = InterruptRequest()
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            # None: a handler that is not Python's and could not be restored
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                before[number] = signal.signal(number, request.request)
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
