"""Another program that study_scaling measures beside ours; those that we compare with are in benchmarks/."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any


@dataclass(frozen=True)
class Rival:
    """A program that is measured on the same meshes, and the differences from ours.

    `task` names a function as "module:function", which runs in its own process. It takes a point's settings and returns
    a row with method, version, cells, tets, nodes, dt, ms, ns_per_tet, ours_ms, setup_s, peak_MB and differs.
    If `beside` names methods of ours, it takes the problem of one and returns functions that each start the motion and
    return its step; these take turns with ours, and the fastest is `baseline_ms` of our row.
    """

    name: str
    task: str
    label: str
    color: str
    differs: str
    beside: tuple[str, ...] = ()


def import_task(name: str) -> Callable[..., Any]:
    """Return the function that is named "module:function"."""
    module, _, function = name.partition(":")
    task: Callable[..., Any] = getattr(import_module(module), function)
    return task
