"""Cases made in Python: meshes and loads from arrays, supports and loads from functions of X and t."""

import inspect
import pickle
from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from pipeline.arrays import Floats
from pipeline.case import Case
from pipeline.case.model import validate_case
from pipeline.case.python_values import PythonValue
from pipeline.errors import CaseError, MeshError
from pipeline.mesh.cleanup import check_connectivity, check_points, orient_cells
from pipeline.mesh.node_order import SIMPLEX_DEGREES
from pipeline.mesh.quadratic import QuadraticMesh
from pipeline.mesh.side_nodes import arrange_sides
from pipeline.mesh.simplex import Mesh
from pipeline.problem.problem import build_mesh

_SAMPLES = 16  # times at which a function is evaluated: its values say whether it is the same as before


def make_case(
    name: str,
    *,
    mesh: Mesh | QuadraticMesh | tuple[Any, Any] | Mapping[str, Any],
    material: Mapping[str, float] | None = None,
    schedule: Mapping[str, float],
    supports: Sequence[Mapping[str, Any]] = (),
    loads: Mapping[str, Any] | None = None,
    initial: Mapping[str, Any] | None = None,
    **sections: Any,
) -> Case:
    """Return a case that was made in Python; it runs, resumes and reports like one from a file.

    Every section has the keys of a case file. In addition `mesh` may be a Mesh, a QuadraticMesh or a pair of arrays:
    points (n, d) [m] and cells, (e, d + 1) or, of order 2 with straight or curved sides, (e, 6) in the plane and
    (e, 10) in space; `mesh.order` follows from them. In a support, `nodes` may be a mask (n,) or a function of X (n, d)
    that returns one, and `motion` (or its `displacement`, beside `until`) a function of X (k, d) and t [s] that returns
    displacements (k, d) [m], zero at t = 0. In `loads`, `body_force` [N/m3] and `nodal_forces` [N] may be arrays (n, d)
    or functions of X or of X and t that return them. In `initial`, `velocity` [m/s] may be an array (n, d) or a
    function of X. Other `sections` are materials (a list), method, output, movie and variants; `material` may be left
    out if materials cover all cells.

    The result folder describes arrays and functions but does not contain them: to solve such a case again, make it
    again. A function counts as unchanged if its code, the values that it refers to, and its results at 16 times in the
    schedule are the same. Raises CaseError if a section is wrong, a shape does not fit or a value is not finite.
    """
    path = Path(f"{name} (made in Python)")
    document: dict[str, Any] = {"name": name, "schedule": schedule, **sections}
    if material is not None:
        document["material"] = material
    document["mesh"] = _describe_mesh(mesh, path) if not isinstance(mesh, Mapping) else mesh
    case = validate_case(document, path)
    describer = _Describer(
        path, build_mesh(case).points, case.schedule.dt * case.schedule.steps_per_frame * case.schedule.frames
    )
    document["supports"] = [describer.describe_support(f"supports.{i}", support) for i, support in enumerate(supports)]
    document["loads"] = describer.describe_loads(loads or {})
    document["initial"] = describer.describe_initial(initial or {})
    return validate_case(document, path)


class _Describer:
    """Turns the arrays and functions of one case into values for its sections."""

    def __init__(self, path: Path, points: Floats, end: float) -> None:
        self.path, self.points = path, points
        self.times = np.linspace(0.0, end, _SAMPLES).tolist()

    def describe_support(self, key: str, support: Mapping[str, Any]) -> dict[str, Any]:
        """Return a support with node numbers in place of a mask or function, and its motion."""
        out = dict(support)
        nodes, motion = out.get("nodes"), out.get("motion")
        if callable(nodes):
            nodes = nodes(self.points)
        if isinstance(nodes, np.ndarray):
            out["nodes"] = self._list_nodes(f"{key}.nodes", nodes)
        if callable(motion):
            out["motion"] = {"displacement": self._describe_motion(f"{key}.motion", motion, out)}
        elif isinstance(motion, Mapping) and callable(displacement := motion.get("displacement")):
            function = self._describe_motion(f"{key}.motion.displacement", displacement, out)
            out["motion"] = {**motion, "displacement": function}
        return out

    def _describe_motion(self, key: str, function: Callable[..., Any], support: Mapping[str, Any]) -> PythonValue:
        X = self.points[support["nodes"]] if "nodes" in support else self.points
        described = self._describe_function(key, function, X)
        offset = np.abs(described.value(X, 0.0)).max(initial=0.0)
        if offset > 0:
            raise CaseError(f"{self.path}: {key}: moves a node by {offset:.3g} m at t = 0; it must start at rest")
        return described

    def describe_loads(self, loads: Mapping[str, Any]) -> dict[str, Any]:
        """Return the loads with fields in place of arrays and functions."""
        out = dict(loads)
        force = out.get("body_force")
        if callable(force) or (isinstance(force, np.ndarray) and force.ndim == 2):
            out["body_force_field"] = out.pop("body_force")
        for name in ("body_force_field", "nodal_forces"):
            if name in out:
                out[name] = self._describe_field(f"loads.{name}", out[name])
        return out

    def describe_initial(self, initial: Mapping[str, Any]) -> dict[str, Any]:
        """Return the initial motion with a field in place of an array or function."""
        out = dict(initial)
        velocity = out.get("velocity")
        if callable(velocity):
            velocity = velocity(self.points)
        if isinstance(velocity, np.ndarray) and velocity.ndim == 2:
            del out["velocity"]
            values = self._check_values("initial.velocity", velocity, self.points.shape)
            out["velocity_field"] = PythonValue(f"array {values.shape}, {_digest(values)}", values)
        return out

    def _describe_field(self, key: str, value: Any) -> PythonValue:
        if not callable(value):
            values = self._check_values(key, value, self.points.shape)
            return PythonValue(f"array {values.shape}, {_digest(values)}", values)
        return self._describe_function(key, value, self.points)

    def _describe_function(self, key: str, function: Callable[..., Any], X: Floats) -> PythonValue:
        """Return a function of X and t that returns float64 (k, d), described by its name, code and sampled values."""
        takes_time = _count_arguments(function) > 1

        def evaluate(X: Floats, time: float) -> Floats:
            values = function(X, time) if takes_time else function(X)
            return self._check_values(key, values, X.shape)

        samples = [evaluate(X, time) for time in (self.times if takes_time else self.times[:1])]
        name = getattr(function, "__name__", type(function).__name__)
        return PythonValue(f"function {name}, {_digest(np.stack(samples), *_list_parts(function))}", evaluate)

    def _check_values(self, key: str, values: Any, shape: tuple[int, ...]) -> Floats:
        array = np.asarray(values, dtype=np.float64)
        try:
            array = np.ascontiguousarray(np.broadcast_to(array, shape))
        except ValueError:
            raise CaseError(f"{self.path}: {key}: has shape {array.shape}, not {shape}") from None
        if not np.isfinite(array).all():
            raise CaseError(f"{self.path}: {key}: {int((~np.isfinite(array)).sum())} values are not finite")
        return array

    def _list_nodes(self, key: str, nodes: np.ndarray) -> list[int]:
        if nodes.dtype == bool:
            if nodes.shape != self.points.shape[:1]:
                raise CaseError(f"{self.path}: {key}: the mask has shape {nodes.shape}, not {self.points.shape[:1]}")
            if not nodes.any():
                low, high = self.points.min(axis=0).tolist(), self.points.max(axis=0).tolist()
                raise CaseError(f"{self.path}: {key}: selects no node; the mesh spans {low} to {high}")
            nodes = np.flatnonzero(nodes)
        return [int(node) for node in nodes]


def _describe_mesh(mesh: Mesh | QuadraticMesh | tuple[Any, Any], path: Path) -> dict[str, Any]:
    """Return the section of a mesh that is given as an object or as points and cells."""
    points, cells = (mesh.points, mesh.cells) if isinstance(mesh, Mesh | QuadraticMesh) else mesh
    points, cells = np.array(points, dtype=np.float64), np.array(cells, dtype=np.int64)
    columns = cells.shape[1] if cells.ndim == 2 else 0
    order, d = SIMPLEX_DEGREES.get(columns, (0, 0))
    if points.ndim != 2 or not d or points.shape[1] != d:
        raise CaseError(
            f"{path}: mesh: points have shape {points.shape} and cells {cells.shape}; "
            "give (n, 3) with (e, 4) or (e, 10) for tetrahedra, or (n, 2) with (e, 3) or (e, 6) for triangles"
        )
    try:
        check_connectivity(points, cells)
        if order == 2:
            check_points(points)
            cells, _ = arrange_sides(points, cells)
    except MeshError as error:
        raise CaseError(f"{path}: mesh: {error}") from None
    cells, _ = orient_cells(points, cells)
    arrays = PythonValue(f"array {points.shape} and {cells.shape}, {_digest(points, cells)}", (points, cells))
    return {"arrays": arrays, **({"order": 2} if order == 2 else {})}


def _count_arguments(function: Callable[..., Any]) -> int:
    """Return how many positional arguments a function takes; 2 if Python cannot tell."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return 2
    return sum(p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) and p.default is p.empty for p in parameters)


def _list_parts(function: Callable[..., Any], seen: frozenset[int] = frozenset()) -> list[bytes]:
    """Return the code of a function and the values that it refers to: constants, defaults, closure and globals.

    A value that cannot be written down differs in every process: then the case counts as changed, never as unchanged.
    """
    if id(function) in seen:  # it calls itself
        return []
    code = getattr(function, "__code__", None)
    if code is None:
        return _list_value(function, seen)
    cells = [cell.cell_contents for cell in getattr(function, "__closure__", None) or ()]
    known = getattr(function, "__globals__", {})
    values = [*(getattr(function, "__defaults__", None) or ()), *cells]
    values += [known[name] for name in code.co_names if name in known and not isinstance(known[name], ModuleType)]
    inner = seen | {id(function)}
    return [*_list_constants(code), *(part for value in values for part in _list_value(value, inner))]


def _list_constants(code: CodeType) -> list[bytes]:
    """Return the instructions, names and constants of a function's code and of the functions inside it."""
    parts = [code.co_code, repr(code.co_names).encode()]
    for constant in code.co_consts:
        parts += _list_constants(constant) if isinstance(constant, CodeType) else [repr(constant).encode()]
    return parts


def _list_value(value: Any, seen: frozenset[int]) -> list[bytes]:
    """Return a value as bytes; a function as its own parts, so that they are the same in every process."""
    if isinstance(value, FunctionType):
        return _list_parts(value, seen)
    try:
        return [pickle.dumps(value)]
    except Exception:  # of any kind: the value decides how it is pickled
        return [repr(value).encode(), str(id(value)).encode()]


def _digest(*parts: Any) -> str:
    total = sha256()
    for part in parts:
        total.update(part if isinstance(part, bytes) else np.ascontiguousarray(part).tobytes())
    return f"sha256 {total.hexdigest()[:16]}"
