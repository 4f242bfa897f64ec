"""Boundary and initial conditions: node selections, supports and their motions, dead loads, the initial state."""

from collections.abc import Callable
from typing import Any

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.case import Case, SpinSpec, SupportSpec
from pipeline.case.python_values import PythonValue
from pipeline.fem.body import Body
from pipeline.fem.loads import body_force, body_force_field, normal_traction
from pipeline.fem.supports import Guides, Motion, PrescribedMotion, RigidMotion, Supports
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.surface import find_boundary_faces
from pipeline.stepping.state import State

AXES = {"x": 0, "y": 1, "z": 2}
_REACH = 1e-9  # of the size: coordinates of nodes on a plane are off by rounding, about 1e-16 of the size
_NEAR = 1e-6  # of the size: single precision, or text of seven digits, takes nodes that far off a plane
_FIRST_INSTANT = 1e-4  # of a step: the time over which the initial velocity of a prescribed motion is taken


def read_vector(case: Case, key: str, value: tuple[float, ...] | None, d: int) -> Floats:
    """Return a vector (d,) of the case, zeros if it is None; raises CaseError if its length is not d."""
    if value is None:
        return np.zeros(d)
    if len(value) != d:
        raise case.make_error(key, f"{list(value)} has {len(value)} components, the mesh has {d} dimensions")
    return np.array(value, dtype=np.float64)


def select_nodes(case: Case, key: str, selector: Any, mesh: ElementMesh) -> Ints:
    """Return the nodes that a selector of the case names; raises CaseError if there are none."""
    X = mesh.points
    reach = _REACH * mesh.size
    for name in ("plane", "below", "above"):
        chosen = getattr(selector, name)
        if chosen is not None and AXES[chosen if name == "plane" else chosen.axis] >= mesh.dimension:
            raise case.make_error(f"{key}.{name}", "'z' is not an axis of a planar mesh")
    if selector.plane is not None:
        mask = np.abs(X[:, AXES[selector.plane]] - selector.at) <= reach
    elif selector.box is not None:
        low, high = (read_vector(case, f"{key}.box", corner, mesh.dimension) for corner in selector.box)
        mask = np.all((low - reach <= X) & (high + reach >= X), axis=1)
    elif selector.sphere is not None:
        center = read_vector(case, f"{key}.sphere.center", selector.sphere.center, mesh.dimension)
        mask = np.linalg.norm(X - center, axis=1) <= selector.sphere.radius + reach
    elif selector.below is not None:
        mask = X[:, AXES[selector.below.axis]] < selector.below.at
    elif selector.above is not None:
        mask = X[:, AXES[selector.above.axis]] > selector.above.at
    else:
        return _check_nodes(case, key, selector.nodes, len(X))
    if not mask.any():
        low, high = X.min(axis=0), X.max(axis=0)
        raise case.make_error(key, f"selects no node; the mesh spans {low.tolist()} to {high.tolist()}")
    return np.flatnonzero(mask)


def note_near_nodes(case: Case, mesh: ElementMesh) -> list[str]:
    """Return notes on planes of supports and tractions that miss nodes nearby, as rounded coordinates do."""
    notes = []
    for name, selectors in (("supports", case.supports), ("loads.traction", case.loads.traction)):
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
        motion = _make_motion(case, f"supports.{i}.motion", spec.motion, mesh)
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
    velocity = None if spec.motion is None else spec.motion.velocity
    lost = [] if velocity is None else [name for name, i in AXES.items() if i not in axes and any(velocity[i : i + 1])]
    if lost:
        message = f"moves the nodes along {lost[0]}, which is not one of the components {', '.join(spec.components)}"
        raise case.make_error(f"{key}.motion.velocity", message)
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


def _make_motion(case: Case, key: str, spec: Any, mesh: ElementMesh) -> Motion:
    d = mesh.dimension
    if spec.displacement is not None:
        displacement = get_python_value(case, f"{key}.displacement", spec.displacement)
        return PrescribedMotion(displacement, _FIRST_INSTANT * case.schedule.dt)
    velocity = read_vector(case, f"{key}.velocity", spec.velocity, d)
    if spec.spin is None:
        return RigidMotion(velocity, np.array([0.0, 0.0, 1.0]), 0.0, np.zeros(d))
    axis = _read_axis(case, f"{key}.spin", spec.spin, d)
    if spec.spin.center is None:
        raise case.make_error(f"{key}.spin.center", "missing: the point that the supports turn about")
    center = read_vector(case, f"{key}.spin.center", spec.spin.center, d)
    return RigidMotion(velocity, axis, float(np.radians(spec.spin.rate)), center)


def _read_axis(case: Case, key: str, spin: SpinSpec, d: int) -> Floats:
    """Return the unit axis (3,); in the plane it must be along z."""
    axis = np.array(spin.axis, dtype=np.float64)
    if d == 2 and axis[:2].any():
        raise case.make_error(f"{key}.axis", f"{list(spin.axis)} is not along z; the mesh is planar")
    axis /= np.abs(axis).max()  # the square of a tiny component would underflow
    return np.asarray(axis / np.linalg.norm(axis))


def make_dead_load(case: Case, mesh: ElementMesh) -> Floats:
    """Return the sum of the dead loads (n, d) [N]."""
    d = mesh.dimension
    density = case.material.density * read_vector(case, "loads.gravity", case.loads.gravity, d)
    if case.loads.body_force is not None:
        b = case.loads.body_force
        density += b.factor * read_vector(case, "loads.body_force", b.value, d)
    f = body_force(mesh, density)
    faces, _ = find_boundary_faces(mesh) if case.loads.traction else (np.zeros((0, d), np.int64), None)
    for i, spec in enumerate(case.loads.traction):
        chosen = np.zeros(len(mesh.points), dtype=bool)
        chosen[select_nodes(case, f"loads.traction.{i}", spec, mesh)] = True
        loaded = faces[chosen[faces].all(axis=1)]
        if not len(loaded):
            raise case.make_error(f"loads.traction.{i}", "its nodes are not the corners of any boundary face")
        f += normal_traction(mesh, loaded, spec.normal_traction)
    return f + _integrate_fields(case, mesh)


def get_python_value(case: Case, key: str, entry: PythonValue) -> Any:
    """Return an array or function that the case carries; raises CaseError if it was read back from a file."""
    if entry.value is None:
        raise case.make_error(key, "was given in Python and is not in the file; make the case in Python again")
    return entry.value


def _integrate_fields(case: Case, mesh: ElementMesh) -> Floats:
    """Return the nodal forces (n, d) [N] of arrays that were given in Python."""
    f = np.zeros_like(mesh.points)
    for name, integrate in _LOAD_FIELDS.items():
        entry = getattr(case.loads, name)
        if entry is not None and not callable(value := get_python_value(case, f"loads.{name}", entry)):
            f += integrate(mesh, value)
    return f


def make_varying_load(case: Case, mesh: ElementMesh) -> Callable[[float], Floats] | None:
    """Return the dead loads (n, d) [N] that are functions of time [s], None if there are none."""
    functions = [
        (integrate, value)
        for name, integrate in _LOAD_FIELDS.items()
        if (entry := getattr(case.loads, name)) is not None
        and callable(value := get_python_value(case, f"loads.{name}", entry))
    ]
    if not functions:
        return None

    def load(time: float) -> Floats:
        return np.asarray(sum(integrate(mesh, function(mesh.points, time)) for integrate, function in functions))

    return load


_LOAD_FIELDS: dict[str, Callable[[ElementMesh, Floats], Floats]] = {
    "body_force_field": body_force_field,
    "nodal_forces": lambda mesh, forces: forces,
}


def make_initial_state(case: Case, body: Body) -> State:
    """Return the initial state: rest positions, the case's velocity and spin, and the supports' for held nodes."""
    mesh, initial = body.mesh, case.initial
    d = mesh.dimension
    v = np.broadcast_to(read_vector(case, "initial.velocity", initial.velocity, d), mesh.points.shape)
    if initial.velocity_field is not None:
        v = get_python_value(case, "initial.velocity_field", initial.velocity_field)
    if initial.spin is not None:
        mean = mesh.node_volumes @ mesh.points / mesh.rest_volumes.sum()  # the center of mass of a uniform body
        spin = initial.spin
        center = mean if spin.center is None else read_vector(case, "initial.spin.center", spin.center, d)
        omega = np.radians(spin.rate) * _read_axis(case, "initial.spin", spin, d)
        arm = np.pad(mesh.points - center, [(0, 0), (0, 3 - d)])
        v = v + np.cross(omega, arm)[:, :d]
    v = np.where(body.free_mask[:, None], initial.factor * v, 0.0)
    for nodes, motion in body.supports.motions:
        v[nodes] = motion.velocities(mesh.points[nodes])
    if body.supports.guides is not None:
        body.supports.guides.set_velocities(mesh.points, v)
    return State(0, mesh.points.copy(), v)
