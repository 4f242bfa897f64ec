"""The memory of this machine, as reported by the operating system."""

import math
import os


def read_installed_bytes() -> float:
    """Return the installed memory [bytes], infinite if the system does not report it."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return math.inf


def read_free_bytes() -> float:
    """Return the free memory [bytes], infinite if the system does not report it."""
    try:
        with open("/proc/meminfo") as meminfo:
            kilobytes = [line.split()[1] for line in meminfo if line.startswith("MemAvailable:")]
        return float(kilobytes[0]) * 1024
    except (OSError, IndexError, ValueError):
        return math.inf
