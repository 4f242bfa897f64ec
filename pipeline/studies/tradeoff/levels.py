"""The meshes that a trade-off study compares: refinements of the case's own, with elements of order 1 and 2."""

from collections.abc import Sequence
from math import log2
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree

from pipeline.arrays import Ints
from pipeline.case import Case
from pipeline.errors import SolveError
from pipeline.mesh.element_mesh import ElementMesh

ORDERS = (1, 2)
# of the case's mesh, if it can be refined so; coarser ones are worth their cost with order 2 only
_REFINEMENTS = {1: (1.0, 2.0), 2: (0.5, 1.0, 2.0)}
_SAME_PLACE = 1e-9  # of the body's size


class MeshLevel(NamedTuple):
    """A mesh: the case's cells along each axis times `refinement`, of an order."""

    refinement: float
    order: int

    def __str__(self) -> str:
        return f"cells x {self.refinement:g} of order {self.order}"


def choose_levels(
    case: Case, refinements: Sequence[float], orders: Sequence[int], *, quick: bool
) -> tuple[tuple[MeshLevel, ...], tuple[str, ...]]:
    """Return the levels that can be compared, coarsest first, the finest one last, and notes if there is only one.

    Raises CaseError for an order or a refinement that the case's mesh cannot have.
    """
    own = MeshLevel(1.0, case.mesh.order)
    for order in orders:
        if order not in ORDERS:
            raise case.make_error("mesh.order", f"--order {order}: orders are 1 and 2")
    for factor in refinements:
        if reason := _find_obstacle(case, factor):
            raise case.make_error("mesh.cells" if case.mesh.shape else "mesh.file", f"--refine {factor:g}: {reason}")
        if (max(refinements) / factor) % 1:
            largest = f"{max(refinements):g}"
            raise case.make_error("mesh.cells", f"--refine {factor:g} does not divide {largest}: no common nodes")
    if reason := _find_dependence(case):
        return (own,), (f"mesh error not available: {reason}",)
    chosen = {own}
    for order in orders or ((own.order,) if quick else ORDERS):
        wanted = refinements or ((1.0,) if quick else _REFINEMENTS[order])
        chosen |= {MeshLevel(float(r), order) for r in wanted if _find_obstacle(case, r) is None}
    levels = tuple(sorted(chosen, key=lambda level: (level.order, level.refinement)))
    return levels, () if len(levels) > 1 else ("mesh error not available: one mesh only (--refine 2, --order 1 2)",)


def _find_dependence(case: Case) -> str | None:
    """Return why a finer mesh or another order would be another scene, None if it is the same."""
    loads = case.loads
    regions = {"supports": case.supports, "loads.traction": loads.traction, "loads.point": loads.point}
    for key, entries in regions.items():
        for number, entry in enumerate(entries):
            if entry.nodes is not None:
                return f"{key}.{number}.nodes names nodes, which differ in other meshes; select them by place"
            if key == "loads.point" and not isinstance(entry.at, tuple):
                return f"{key}.{number}.force acts on each selected node, of which other meshes have more; give a point"
    return "loads.nodal_forces belong to the nodes of one mesh" if loads.nodal_forces is not None else None


def _find_obstacle(case: Case, factor: float) -> str | None:
    """Return why a case's mesh cannot be refined by a factor, None if it can."""
    mesh = case.mesh
    if not 0 < factor < np.inf:
        return "factors are positive numbers"
    if mesh.cells is not None:
        odd = [count for count in mesh.cells if (factor * count) % 1 or factor * count < 1]
        return f"{odd[0]} cells times {factor:g} is not a whole number" if odd else None
    if factor < 1 or log2(factor) % 1:
        return "the cells of a file are cut in two along each axis: factors are 1, 2, 4, ..."
    return None


def make_mesh_keys(case: Case, level: MeshLevel) -> dict[str, Any]:
    """Return the mesh keys of a level; none for the case's own mesh."""
    mesh, keys = case.mesh, dict[str, Any]()
    if level.order != mesh.order:
        keys["mesh.order"] = level.order
    if level.refinement != 1 and mesh.cells is not None:
        keys["mesh.cells"] = [round(level.refinement * count) for count in mesh.cells]
    elif level.refinement != 1:
        keys["mesh.refine"] = mesh.refine + round(log2(level.refinement))
    return keys


def match_nodes(mesh: ElementMesh, finer: ElementMesh) -> tuple[Ints, Ints]:
    """Return the nodes of a mesh that a finer one has too, at rest, and their numbers there.

    Raises SolveError if a corner of the mesh is not a node of the finer one: their errors cannot be compared.
    """
    found = KDTree(finer.points).query(mesh.points)
    distance, partner = np.asarray(found[0]), np.asarray(found[1], dtype=np.int64)
    nodes = np.flatnonzero(distance <= _SAME_PLACE * mesh.size)
    if not np.isin(mesh.cells[:, : mesh.dimension + 1], nodes).all():
        raise SolveError(f"{mesh.name}: corners of its cells are no nodes of the finest mesh, so that none is compared")
    return nodes, partner[nodes]
