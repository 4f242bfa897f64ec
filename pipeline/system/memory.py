"""The memory of this machine, as reported by the operating system."""

import math
import os

from pipeline.errors import MeshError


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


def require_memory(cells: int, bytes_per_cell: int, advice: str) -> None:
    """Raise MeshError if a mesh of so many cells would not fit into free memory: the system would kill the process."""
    needed, free = cells * bytes_per_cell, read_free_bytes()
    if needed > free:
        raise MeshError(
            f"{cells} cells take {needed / 1e9:.3g} GB to build and more to solve; {free / 1e9:.3g} GB of memory "
            f"are free; {advice}"
        )
