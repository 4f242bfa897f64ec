"""An end on request: SIGINT and SIGTERM let the current step finish."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any


class Interrupted(KeyboardInterrupt):
    """A run was asked to stop and did so after a step; the message says how to go on."""


@dataclass
class InterruptRequest:
    """Whether a signal asked for an end; while `solving` it waits for the step, else it is a KeyboardInterrupt."""

    requested: bool = False
    solving: bool = False

    def request(self, *_: Any) -> None:
        """Note that an end is asked for; the second time, or where no step is under way, end at once."""
        if self.requested or not self.solving:
            raise KeyboardInterrupt
        self.requested = True


@contextmanager
def catch_interrupts() -> Iterator[InterruptRequest]:
    """Yield what SIGINT and SIGTERM set: in the main thread, and where they are not ignored."""
    asked = InterruptRequest()
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            # None: a handler that is not Python's, which could not be put back
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                before[number] = signal.signal(number, asked.request)
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
