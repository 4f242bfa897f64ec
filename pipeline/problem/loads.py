"""Loads of a case: the nodal forces of each, their sums, and what a user wants to know about them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats, Ints
from pipeline.case import Case, PointLoadSpec, TractionSpec
from pipeline.fem.histories import History
from pipeline.fem.loads import (
    VaryingLoad,
    body_force,
    body_force_field,
    gravity_force,
    normal_traction,
    point_force,
    vector_traction,
)
from pipeline.fem.material import MaterialValues
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.locate import locate_points
from pipeline.mesh.surface import find_boundary_faces, measure_distance
from pipeline.problem.case_values import get_python_value, list_times, read_history, read_vector
from pipeline.problem.conditions import select_nodes

_FIELDS: dict[str, Callable[[ElementMesh, Floats], Floats]] = {
    "body_force_field": body_force_field,
    "nodal_forces": lambda mesh, forces: forces,
}

HistorySpec = str | Sequence[tuple[float, float]]


class LoadTotal(NamedTuple):
    """A load's resultant (d,) [N], at factor 1 if it has a history; `factors` are those at the times of the run."""

    key: str
    force: Floats
    history: HistorySpec | None = None
    factors: tuple[float, ...] = ()


@dataclass(frozen=True)
class LoadSum:
    """All loads of a case: the sum of constant ones (n, d) [N], and the varying ones, None if there are none."""

    constant: Floats
    varying: VaryingLoad | None
    totals: tuple[LoadTotal, ...]
    notes: tuple[str, ...]


def make_loads(case: Case, mesh: ElementMesh, held: Ints, density: MaterialValues) -> LoadSum:
    """Return the loads of a case on a mesh whose nodes `held` do not move freely; raises CaseError."""
    builder = _LoadBuilder(case, mesh, density)
    free = np.ones(len(mesh.points), dtype=bool)
    free[held] = False
    constant, totals = np.zeros_like(mesh.points), []
    varying: dict[HistorySpec, tuple[History, Floats]] = {}
    for key, forces, spec in builder.iterate_loads():
        history = None if spec is None else read_history(case, f"{key}.history", spec)
        factors = () if history is None else tuple(history(time) for time in list_times(case))
        totals.append(LoadTotal(key, _sum_forces(forces), spec, factors))
        builder.notes += _note_idle_load(key, forces, free, factors)
        if spec is None or history is None:
            constant += forces
        elif spec in varying:  # loads of one history are one load
            varying[spec] = history, varying[spec][1] + forces
        else:
            varying[spec] = history, forces
    functions = builder.list_functions()
    load = VaryingLoad(list(varying.values()), functions) if varying or functions else None
    return LoadSum(constant, load, tuple(totals), tuple(builder.notes))


class _LoadBuilder:
    """Makes the nodal forces of a case's loads, and collects notes."""

    def __init__(self, case: Case, mesh: ElementMesh, density: MaterialValues) -> None:
        self.case = case
        self.mesh = mesh
        self.density = density
        self.notes: list[str] = []

    @cached_property
    def _faces(self) -> Ints:
        return find_boundary_faces(self.mesh)[0]

    def iterate_loads(self) -> Iterator[tuple[str, Floats, HistorySpec | None]]:
        """Yield the key, the nodal forces (n, d) [N] and the history of each load that is no function from Python."""
        case, mesh, loads = self.case, self.mesh, self.case.loads
        d = mesh.dimension
        if loads.gravity is not None:
            key, gravity = "loads.gravity", loads.gravity
            if isinstance(gravity, tuple):
                g, history = read_vector(case, key, gravity, d), None
            else:
                g, history = read_vector(case, f"{key}.value", gravity.value, d), gravity.history
            yield key, gravity_force(mesh, self.density, g), history
        if (b := loads.body_force) is not None:
            density = b.factor * read_vector(case, "loads.body_force", b.value, d)
            yield "loads.body_force", body_force(mesh, density), b.history
        for i, traction in enumerate(loads.traction):
            key = f"loads.traction.{i}"
            yield key, self._integrate_traction(key, traction), traction.history
        for i, point in enumerate(loads.point):
            key = f"loads.point.{i}"
            yield key, self._spread_force(key, point), point.history
        for name, integrate in _FIELDS.items():
            entry = getattr(loads, name)
            if entry is not None and not callable(value := get_python_value(case, f"loads.{name}", entry)):
                yield f"loads.{name}", integrate(mesh, value), None

    def list_functions(self) -> list[Any]:
        """Return the loads that are functions from Python, as functions of time that return nodal forces (n, d) [N]."""
        mesh = self.mesh

        def bind(integrate: Any, function: Any) -> Any:
            return lambda time: integrate(mesh, function(mesh.points, time))

        return [
            bind(integrate, value)
            for name, integrate in _FIELDS.items()
            if (entry := getattr(self.case.loads, name)) is not None
            and callable(value := get_python_value(self.case, f"loads.{name}", entry))
        ]

    def _integrate_traction(self, key: str, spec: TractionSpec) -> Floats:
        mesh = self.mesh
        chosen = np.zeros(len(mesh.points), dtype=bool)
        chosen[select_nodes(self.case, key, spec, mesh)] = True
        loaded = self._faces[chosen[self._faces].all(axis=1)]
        if not len(loaded):
            raise self.case.make_error(key, "its nodes are not the corners of any boundary face")
        corners = self._faces[:, : mesh.dimension]
        selected = np.unique(corners[chosen[corners]])
        left_out = len(np.setdiff1d(selected, loaded))
        if left_out:
            self.notes.append(
                f"{key}: {left_out} of its {len(selected)} corners on the boundary belong to no face of which all "
                "nodes are selected: no traction there"
            )
        if spec.traction is not None:
            return vector_traction(
                mesh, loaded, read_vector(self.case, f"{key}.traction", spec.traction, mesh.dimension)
            )
        assert spec.normal_traction is not None
        return normal_traction(mesh, loaded, spec.normal_traction)

    def _spread_force(self, key: str, spec: PointLoadSpec) -> Floats:
        """Return the nodal forces (n, d) [N] of a force at a point, or on each node of a selection."""
        mesh = self.mesh
        force = read_vector(self.case, f"{key}.force", spec.force, mesh.dimension)
        if not isinstance(spec.at, tuple):
            f = np.zeros_like(mesh.points)
            f[select_nodes(self.case, key, spec, mesh)] = force
            return f
        point = read_vector(self.case, f"{key}.at", spec.at, mesh.dimension)
        cells, weights = locate_points(mesh, point[None])
        if np.isnan(weights).any():
            raise self.case.make_error(
                f"{key}.at",
                f"{list(spec.at)} is outside the body, {measure_distance(mesh, point):.4g} m from it; give a point "
                "inside, or select nodes",
            )
        return point_force(mesh, int(cells[0]), weights[0], force)


def _sum_forces(forces: Floats) -> Floats:
    """Return the resultant (d,) [N]; components that are rounding errors of forces in balance are 0."""
    total = np.asarray(forces.sum(axis=0))
    return np.where(np.abs(total) < 1e-12 * np.abs(forces).sum(), 0.0, total)


def _note_idle_load(key: str, forces: Floats, free: NDArray[np.bool_], factors: Sequence[float]) -> list[str]:
    """Return a note on a load that moves nothing, unless it was given as zero."""
    if forces.any() and not forces[free].any():
        return [f"{key}: its forces are on held nodes only: it moves nothing"]
    if factors and max(map(abs, factors)) < 1e-9:
        return [f"{key}.history: below 1e-9 at every step: it moves nothing"]
    return []


def format_total(total: LoadTotal, end: float) -> str:
    """Return a load as `pipeline check` prints it, for a run that ends at a time [s]."""
    unit = "N" if len(total.force) == 3 else "N/m"  # of thickness
    text = f"{total.key.removeprefix('loads.')}: [{', '.join(f'{part:.6g}' for part in total.force)}] {unit}"
    if not total.factors:
        return text
    factors = total.factors
    name = f'"{total.history}"' if isinstance(total.history, str) else "a table"
    return (
        f"{text} times {name}, which is {factors[0]:.4g} at t = 0 and {factors[-1]:.4g} at {end:.4g} s, "
        f"within {min(factors):.4g} to {max(factors):.4g}"
    )
