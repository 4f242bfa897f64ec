"""The memory of this machine, as far as the system tells."""

import math
import os


def installed_bytes() -> float:
    """Return the bytes of memory there are; infinite where the system does not say."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return math.inf


def free_bytes() -> float:
    """Return the bytes of memory that are free; infinite where the system does not say."""
    try:
        with open("/proc/meminfo") as opened:
            found = [line.split()[1] for line in opened if line.startswith("MemAvailable:")]
        return float(found[0]) * 1024
    except (OSError, IndexError, ValueError):
        return math.inf
