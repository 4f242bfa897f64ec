"""Case -> Problem: looks up every name, checks every vector and node set, makes the body and its initial state."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

from pipeline.arrays import Ints
from pipeline.case import Case, MethodSpec
from pipeline.errors import MeshError, join_names, quote_value
from pipeline.fem.body import Body, Formulation
from pipeline.fem.body_choice import make_body
from pipeline.fem.damping import Rayleigh
from pipeline.fem.laws import Corotational, Law
from pipeline.fem.material import Material
from pipeline.fem.supports import Supports
from pipeline.linear.pardiso import load_mkl
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.files import read_mesh
from pipeline.mesh.node_order import SIMPLEX_DEGREES
from pipeline.mesh.quadratic import make_quadratic_mesh, raise_order, require_quadratic_memory
from pipeline.mesh.refinement import refine_mesh
from pipeline.mesh.simplex import Mesh, label_components
from pipeline.problem.case_values import get_python_value
from pipeline.problem.conditions import (
    make_initial_state,
    make_supports,
    note_near_nodes,
)
from pipeline.problem.loads import LoadSum, LoadTotal, make_loads
from pipeline.problem.materials import describe_materials, make_material, number_materials
from pipeline.problem.methods import (
    INVERSIONS,
    LAWS,
    LINEAR_SOLVERS,
    MASSES,
    ROTATIONS,
    SHAPES,
    STEP_LIMITS,
    STEPPERS,
    find_traits,
)
from pipeline.problem.motions import note_endless_motions
from pipeline.problem.stage_solvers import make_stepper
from pipeline.stepping.state import State, Stepper


@dataclass(frozen=True, eq=False, repr=False)
class Problem:
    """A body, its method, its start and its schedule: all that `frames` needs."""

    name: str
    body: Body
    method: MethodSpec
    start: State
    dt: float
    steps_per_frame: int
    last_frame: int
    notes: tuple[str, ...] = ()
    loads: tuple[LoadTotal, ...] = ()
    materials: Ints | None = None

    def __repr__(self) -> str:
        mesh = self.body.mesh
        return (
            f"<Problem {self.name}: {len(mesh.cells)} cells, {len(mesh.points)} nodes, {self.method.stepper}, "
            f"dt = {self.dt:g} s, {self.frame_count} frames>"
        )

    @property
    def frame_count(self) -> int:
        """Return the number of frames of the whole run; frame 0 is the start."""
        return self.last_frame + 1

    @property
    def last_step(self) -> int:
        """Return the number of steps of the whole run."""
        return self.last_frame * self.steps_per_frame

    def prepare(self) -> Stepper:
        """Return the stepper, ready to step: matrices factored, limits checked."""
        return make_stepper(self.body, self.dt, self.method)


def build(case: Case, *, mesh: ElementMesh | None = None) -> Problem:
    """Return the problem that a resolved case (or one with a single variant) describes.

    `mesh` replaces the case's own. Raises CaseError if a name is unknown, a vector has the wrong length, a selection is
    empty or all nodes are held, and MeshError if the mesh cannot be simulated.
    """
    if case.variant_name is None and len(case.variant_names) == 1:
        case = case.variant(case.variant_names[0])
    elif case.variant_name is None:
        raise case.make_error("variants", f"choose one with case.variant(name): {join_names(case.variant_names)}")
    case = resolve_mass(case)
    _check_method(case)
    mesh = build_mesh(case) if mesh is None else mesh
    supports = make_supports(case, mesh)
    numbers = number_materials(case, mesh)
    material = make_material(case, numbers)
    loads = make_loads(case, mesh, supports.nodes, material.density)
    body = _make_body(case, mesh, material, supports, loads)
    if not body.free_components.size:
        raise case.make_error("supports", f"all {len(mesh.points)} nodes are held; no free node is left")
    _check_step(case, body)
    s = case.schedule
    start = make_initial_state(case, body)
    name = f"{case.name}/{case.variant_name}"
    notes = (*_list_notes(case, mesh), *describe_materials(case, mesh, numbers), *loads.notes)
    several = numbers if numbers is not None and (numbers != numbers[0]).any() else None
    return Problem(
        name, body, case.method, start, s.dt, s.steps_per_frame, s.frames, notes, loads.totals, several
    )  # fmt: skip


def _make_body(case: Case, mesh: ElementMesh, material: Material, supports: Supports, loads: LoadSum) -> Body:
    law, mass, method = _make_law(case, material), MASSES[case.method.mass].part, case.method
    formulation = Formulation(cast(Any, method.rotation_at), cast(Any, method.volumetric))
    body = make_body(mesh, law, supports, loads.constant, mass, loads.varying, formulation)
    m = case.material
    if m is None or (not m.mass_damping and not m.stiffness_damping):
        return body
    return replace(body, damping=Rayleigh(m.mass_damping, m.stiffness_damping))


def _make_law(case: Case, material: Material) -> Law:
    method = case.method
    if find_traits(method).chooses_model:
        return Corotational(material)
    return LAWS[method.law].part(material, ROTATIONS[method.rotation].part)


def build_mesh(case: Case) -> ElementMesh:
    """Return the rest mesh of a case; raises CaseError or MeshError."""
    try:
        mesh = _build_coarse_mesh(case)
        return refine_mesh(mesh, case.mesh.refine) if case.mesh.refine else mesh
    except MeshError as error:
        raise case.make_error("mesh", str(error)) from error


def _build_coarse_mesh(case: Case) -> ElementMesh:
    """Return the mesh before its refinement."""
    spec = case.mesh
    if spec.file is not None:
        assert case.mesh_path is not None
        return read_mesh(case.mesh_path, spec.scale, spec.order)
    if spec.arrays is not None:
        points, cells = get_python_value(case, "mesh.arrays", spec.arrays)
        own_order, d = SIMPLEX_DEGREES[cells.shape[1]]
        if own_order == 2:
            if spec.order == 1:
                raise case.make_error("mesh.order", f"1 does not fit arrays of cells of {cells.shape[1]} nodes; take 2")
            require_quadratic_memory(len(cells), d)
            return make_quadratic_mesh(points, cells, case.name)
        mesh = Mesh(points, cells, name=case.name)
    else:
        assert spec.shape is not None and spec.size is not None and spec.cells is not None
        make_shape = SHAPES[_check_name(case, "mesh.shape", spec.shape, SHAPES)].part
        mesh = make_shape(spec.size, spec.cells, spec.split)
    return raise_order(mesh) if spec.order == 2 else mesh


def resolve_mass(case: Case) -> Case:
    """Return a resolved case with the mass that its stepper needs: an explicit one needs lumped mass."""
    method = case.method
    if method.stepper not in STEP_LIMITS or method.mass == "lumped":
        return case
    inherited = "method.stepper" in case.own_keys and "method.mass" not in case.own_keys
    if "mass" in method.model_fields_set and not inherited:
        raise case.make_error("method.mass", f"{method.stepper} needs 'lumped'")
    note = f"method.mass is set to lumped, because {method.stepper} needs it"
    lumped = method.model_copy(update={"mass": "lumped"})
    return case.model_copy(update={"method": lumped, "notes": (*case.notes, note)})


def _check_method(case: Case) -> None:
    """Raise CaseError if a name is in no table or two parts do not go together."""
    method = case.method
    tables: Mapping[str, Mapping[str, Any]] = {
        "law": LAWS,
        "rotation": ROTATIONS,
        "stepper": STEPPERS,
        "linear_solver": LINEAR_SOLVERS,
        "mass": MASSES,
        "inversion": INVERSIONS,
    }
    for key, table in tables.items():
        _check_name(case, f"method.{key}", getattr(method, key), table)
    traits = find_traits(method)
    has_treatment = INVERSIONS[method.inversion].part is not None
    if method.rotation_at == "element" and (traits.chooses_model or traits.is_converged):
        needed = "'points': with one rotation per element there is no potential"
        raise case.make_error("method.rotation_at", f"model = 'auto' and iterations = 'converged' need {needed}")
    if traits.chooses_model:
        if traits.is_explicit or has_treatment:
            goes_with = "implicit steppers and inversion = 'flip'"
            raise case.make_error("method.model", f"{method.model!r} works only with {goes_with}")
        return
    if has_treatment and (traits.is_linear or method.rotation != "polar" or method.iterations != 1):
        needed = "the corotational law with polar rotations and iterations = 1"
        raise case.make_error(
            "method.inversion", f"{method.inversion!r} depends on the previous step: it needs {needed}"
        )
    if traits.is_linear or traits.is_explicit:
        return
    if traits.is_converged and method.rotation != "polar":
        raise case.make_error(
            "method.iterations", f"'converged' needs a potential, and {method.rotation} has none; use polar"
        )


def _check_step(case: Case, body: Body) -> None:
    """Raise CaseError if the stepper has a limit and dt is not below it."""
    if case.method.stepper not in STEP_LIMITS:
        return
    bound_of, limit_of = STEP_LIMITS[case.method.stepper]
    dt, bound = case.schedule.dt, bound_of(body)
    if dt <= bound:
        return
    limit = limit_of(body)
    if dt >= limit:
        raise case.make_error(
            "schedule.dt",
            f"{dt:g} is above the limit of {case.method.stepper}: {limit:.4g} s for this body, "
            f"{bound:.4g} s by the bound over its cells",
        )


def _check_name(case: Case, key: str, name: str, table: Mapping[str, Any]) -> str:
    if name not in table:
        raise case.make_error(key, f"{quote_value(name)} is not one of {', '.join(table)}")
    return name


def _list_notes(case: Case, mesh: ElementMesh) -> tuple[str, ...]:
    replaced = mesh.regions.note if case.materials and mesh.regions is not None else ""
    told = [note for note in mesh.notes if note != replaced]
    notes = [*case.notes, *told, *note_near_nodes(case, mesh), *note_endless_motions(case)]
    unused = [key for key in ("law", "rotation", "iterations") if f"method.{key}" in case.own_keys]
    traits = find_traits(case.method)
    if traits.chooses_model and unused:
        notes.append(f"method.{', method.'.join(unused)} not used: method.model = {case.method.model!r} decides")
    if LAWS[case.method.law].is_linear and "method.rotation" in case.own_keys:
        notes.append("method.rotation is not used by the linear law")
    if case.method.linear_solver == "pardiso" and not traits.is_explicit and load_mkl() is None:
        notes.append(
            "method.linear_solver = 'pardiso' needs the mkl package, which is not installed: superlu replaces it; "
            "to install it: pip install 'corotational-pipeline[mkl]'"
        )
    pieces, _ = label_components(mesh)
    if pieces > 1:
        notes.append(f"the mesh has {pieces} components")
    return tuple(notes)
