"""Rows of the method tables that a study does not use: a new law or stepper is in the study or reported as left out."""

from collections.abc import Iterable, Mapping
from typing import Any

from pipeline.case import MethodSpec
from pipeline.problem.methods import LAWS, MODELS, ROTATIONS, STEPPERS

_TABLES: Mapping[str, Iterable[str]] = {"model": MODELS, "law": LAWS, "rotation": ROTATIONS, "stepper": STEPPERS}


def list_left_out(methods: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the rows, such as "stepper bdf2", that none of these methods has; a missing key has a case's default."""
    defaults = MethodSpec()
    methods = list(methods)
    used = {key: {method.get(key, getattr(defaults, key)) for method in methods} for key in _TABLES}
    return [f"{key} {name}" for key, table in _TABLES.items() for name in table if name not in used[key]]
