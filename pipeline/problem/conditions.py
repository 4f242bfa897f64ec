"""Boundary and initial conditions: node selections, supports, the initial state."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats, Ints
from pipeline.case import Case, SelectorSpec, SupportSpec
from pipeline.fem.body import Body
from pipeline.fem.loads import integrate_density
from pipeline.fem.supports import Guides, Motion, Supports
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.problem.case_values import get_python_value, read_axis, read_vector
from pipeline.problem.motions import make_motion
from pipeline.stepping.state import State

AXES = {"x": 0, "y": 1, "z": 2}
_REACH = 1e-9  # of the size: coordinates of nodes on a plane are off by rounding, about 1e-16 of the size
_NEAR = 1e-6  # of the size: single precision, or text of seven digits, takes nodes that far off a plane


def select_nodes(case: Case, key: str, selector: Any, mesh: ElementMesh) -> Ints:
    """Return the nodes that a selector of the case names; raises CaseError if there are none."""
    X = mesh.points
    if selector.nodes is not None:
        return _check_nodes(case, key, selector.nodes, len(X))
    if selector.plane is None:
        mask = find_inside(case, key, selector, X, mesh.size)
    elif AXES[selector.plane] >= mesh.dimension:
        raise case.make_error(f"{key}.plane", "'z' is not an axis of a planar mesh")
    else:
        mask = np.abs(X[:, AXES[selector.plane]] - selector.at) <= _REACH * mesh.size
    if not mask.any():
        low, high = X.min(axis=0), X.max(axis=0)
        raise case.make_error(key, f"selects no node; the mesh spans {low.tolist()} to {high.tolist()}")
    return np.flatnonzero(mask)


def find_inside(case: Case, key: str, selector: Any, X: Floats, size: float) -> NDArray[np.bool_]:
    """Return which points X (n, d) of a body of that size are in the box, ball or half space of a selector.

    Raises CaseError if it has another dimension.
    """
    d, reach = X.shape[1], _REACH * size
    if selector.box is not None:
        low, high = (read_vector(case, f"{key}.box", corner, d) for corner in selector.box)
        return np.asarray(np.all((low - reach <= X) & (high + reach >= X), axis=1))
    if selector.sphere is not None:
        center = read_vector(case, f"{key}.sphere.center", selector.sphere.center, d)
        return np.asarray(np.linalg.norm(X - center, axis=1) <= selector.sphere.radius + reach)
    name, side = ("above", selector.above) if selector.below is None else ("below", selector.below)
    if AXES[side.axis] >= d:
        raise case.make_error(f"{key}.{name}", "'z' is not an axis of a planar mesh")
    along = X[:, AXES[side.axis]]
    return np.asarray(along < side.at if name == "below" else along > side.at)


def note_near_nodes(case: Case, mesh: ElementMesh) -> list[str]:
    """Return notes on planes of supports and loads that miss nodes nearby, as rounded coordinates do."""
    notes = []
    for name, selectors in _list_selectors(case):
        for i, selector in enumerate(selectors):
            if selector.plane is None or selector.at is None:
                continue
            distances = np.abs(mesh.points[:, AXES[selector.plane]] - selector.at)
            missed = int(((distances > _REACH * mesh.size) & (distances <= _NEAR * mesh.size)).sum())
            if missed:
                notes.append(
                    f"{name}.{i}: {missed} more nodes lie within {_NEAR:g} of the body's size of that plane, and are "
                    f"not on it; to take them: box, or round the coordinates along {selector.plane}"
                )
    return notes


def _list_selectors(case: Case) -> list[tuple[str, Sequence[SelectorSpec]]]:
    return [("supports", case.supports), ("loads.traction", case.loads.traction), ("loads.point", case.loads.point)]


def _check_nodes(case: Case, key: str, nodes: tuple[int, ...], count: int) -> Ints:
    if max(nodes) >= count:
        raise case.make_error(f"{key}.nodes", f"{max(nodes)} is not a node; the mesh has {count}, counted from 0")
    return np.unique(np.array(nodes, dtype=np.int64))


def make_supports(case: Case, mesh: ElementMesh) -> Supports:
    """Return the held nodes and components and their motions; raises CaseError if one would have two."""
    n, d = mesh.points.shape
    taken, is_guided = np.full((n, d), -1), np.zeros(n, dtype=bool)
    motions: list[tuple[Ints, Motion]] = []
    guided_motions: list[tuple[Ints, Motion]] = []
    for i, spec in enumerate(case.supports):
        nodes, axes = select_nodes(case, f"supports.{i}", spec, mesh), _read_components(case, f"supports.{i}", spec, d)
        _check_taken(case, i, nodes, axes, taken)
        taken[nodes[:, None], axes] = i
        if spec.motion is None:
            continue
        motion = make_motion(case, f"supports.{i}.motion", spec.motion, d)
        if len(axes) == d:
            motions.append((nodes, motion))
        else:
            guided_motions.append(((d * nodes[:, None] + axes).ravel(), motion))
            is_guided[nodes] = True
    is_held = taken >= 0
    is_guided |= ~is_held.all(axis=1)  # a node held along all axes is a guided one only if some of them move
    guided = np.flatnonzero(is_held & is_guided[:, None])
    guides = Guides(guided, tuple(guided_motions)) if guided.size else None
    return Supports(np.flatnonzero(~is_guided), tuple(motions), guides)


def _read_components(case: Case, key: str, spec: SupportSpec, d: int) -> Ints:
    """Return the axes along which a support holds its nodes, ascending; raises CaseError if the mesh lacks one."""
    if spec.components is None:
        return np.arange(d)
    axes = np.sort([AXES[name] for name in spec.components])
    if axes[-1] >= d:
        place = spec.components.index("z")
        raise case.make_error(f"{key}.components.{place}", "'z' is not an axis of a planar mesh")
    for name in ("velocity", "displacement"):
        vector = getattr(spec.motion, name, None)
        moved = vector if isinstance(vector, tuple) else ()
        lost = [axis for axis, i in AXES.items() if i not in axes and any(moved[i : i + 1])]
        if lost:
            known = ", ".join(spec.components)
            message = f"moves the nodes along {lost[0]}, which is not one of the components {known}"
            raise case.make_error(f"{key}.motion.{name}", message)
    return axes


def _check_taken(case: Case, number: int, nodes: Ints, axes: Ints, taken: Ints) -> None:
    """Raise CaseError if a component of a node would be held twice, and one of the two supports moves."""
    moves = np.array([spec.motion is not None for spec in case.supports])
    before = taken[nodes[:, None], axes]
    twice = np.argwhere((before >= 0) & (moves[number] | moves[before]))
    if not twice.size:
        return
    node, axis = twice[0]
    other = before[node, axis]
    partial = any(case.supports[i].components is not None for i in (number, other))
    along = f" along {'xyz'[axes[axis]]}" if partial else ""
    raise case.make_error(f"supports.{number}", f"node {nodes[node]} is already held{along} by supports.{other}")


def _find_center_of_mass(body: Body) -> Floats:
    """Return the center of mass (d,) of a body at rest."""
    mesh, density = body.mesh, body.material.density
    if not isinstance(density, np.ndarray):
        return np.asarray(mesh.node_volumes @ mesh.points / mesh.rest_volumes.sum())
    masses = integrate_density(mesh, density)
    return np.asarray(masses @ mesh.points / masses.sum())


def make_initial_state(case: Case, body: Body) -> State:
    """Return the initial state: rest positions, the case's velocity and spin, and the supports' for held nodes."""
    mesh, initial = body.mesh, case.initial
    d = mesh.dimension
    v = np.broadcast_to(read_vector(case, "initial.velocity", initial.velocity, d), mesh.points.shape)
    if initial.velocity_field is not None:
        v = get_python_value(case, "initial.velocity_field", initial.velocity_field)
    if initial.spin is not None:
        mean = _find_center_of_mass(body)
        spin = initial.spin
        center = mean if spin.center is None else read_vector(case, "initial.spin.center", spin.center, d)
        omega = np.radians(spin.rate) * read_axis(case, "initial.spin", spin, d)
        arm = np.pad(mesh.points - center, [(0, 0), (0, 3 - d)])
        v = v + np.cross(omega, arm)[:, :d]
    v = np.where(body.free_mask[:, None], initial.factor * v, 0.0)
    for nodes, motion in body.supports.motions:
        v[nodes] = motion.velocities(mesh.points[nodes])
    if body.supports.guides is not None:
        body.supports.guides.set_velocities(mesh.points, v)
    return State(0, mesh.points.copy(), v)
