"""The swap table: every name that a case may use for a part of its method, and what makes that part.

A new law, rotation, stepper, linear solver or shape is one file and one row here.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import cast

import numpy as np

from pipeline.arrays import Floats
from pipeline.case import MethodSpec
from pipeline.fem.body import Body
from pipeline.fem.compiled_body import make_body
from pipeline.fem.laws import Corotational, Law, Linear, Tangent
from pipeline.fem.loads import consistent_mass_pairs, lumped_mass_pairs
from pipeline.fem.material import Material
from pipeline.fem.rotation import gram_schmidt, polar
from pipeline.linear.banded import BandedCholesky, band_of
from pipeline.linear.cg import block_jacobi_cg
from pipeline.linear.choice import LinearSolver, SuperLU, choice, pardiso_or_lu
from pipeline.linear.pardiso import library
from pipeline.linear.rest_preconditioner import Rest, factor_kind, multigrid_cg, warped_cg
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.simplex import Mesh
from pipeline.stepping import backward_euler, bdf2
from pipeline.stepping.auto import COROTATIONAL, Auto
from pipeline.stepping.backward_euler import BackwardEuler
from pipeline.stepping.bdf2 import BDF2
from pipeline.stepping.energy_guard import EnergyGuard
from pipeline.stepping.inversion import Crossing, Last, Treatment
from pipeline.stepping.newton import Converged, NewtonLimits
from pipeline.stepping.stage import FrozenPasses, Prefactored, StageSolver
from pipeline.stepping.state import Stepper
from pipeline.stepping.symplectic_euler import SymplecticEuler, element_limit, true_limit

Rotation = Callable[[Floats], Floats]

LAWS: Mapping[str, Callable[[Material, Rotation], Law]] = {
    "linear": lambda material, rotation: Linear(material),
    "corotational": Corotational,
}
ROTATIONS: Mapping[str, Rotation] = {"polar": polar, "gram_schmidt": gram_schmidt}
MASSES: Mapping[str, Callable[[Mesh, float], Floats]] = {
    "consistent": consistent_mass_pairs,
    "lumped": lumped_mass_pairs,
}
LINEAR_SOLVERS: Mapping[str, Callable[..., LinearSolver]] = {
    "banded": BandedCholesky,
    "superlu": SuperLU,
    "pardiso": pardiso_or_lu,
    "warped": warped_cg,
    "multigrid": multigrid_cg,
    "cg": block_jacobi_cg,
}
SHAPES: Mapping[str, Callable[[Sequence[float], Sequence[int], str], Mesh]] = {"box": box, "rectangle": rectangle}
# None: what the law's own rotation does
INVERSIONS: Mapping[str, Callable[[], Treatment] | None] = {"flip": None, "last": Last, "crossing": Crossing}


def _backward_euler(body: Body, dt: float, method: MethodSpec) -> Stepper:
    return _guarded(BackwardEuler(body, dt, stage_solver(body, dt, method), _treatment(body, method)), body, method)


def _bdf2(body: Body, dt: float, method: MethodSpec) -> Stepper:
    first = BackwardEuler(body, dt, stage_solver(body, dt, method), _treatment(body, method))
    rest = stage_solver(body, 2 * dt / 3, method)
    return _guarded(BDF2(body, dt, first, rest, _treatment(body, method)), body, method)


def _symplectic_euler(body: Body, dt: float, method: MethodSpec) -> Stepper:
    return EnergyGuard(body, SymplecticEuler(body, dt, _treatment(body, method)))


STEPPERS: Mapping[str, Callable[[Body, float, MethodSpec], Stepper]] = {
    "backward_euler": _backward_euler,
    "bdf2": _bdf2,
    "symplectic_euler": _symplectic_euler,
}
# steppers that are stable below a step only: a bound that accepts at once, and the limit itself [s]
STEP_LIMITS: Mapping[str, tuple[Callable[[Body], float], Callable[[Body], float]]] = {
    "symplectic_euler": (element_limit, true_limit),
}
# what a step of the implicit ones does to a mode of the linear law: its factor for z = omega dt
MODE_FACTORS: Mapping[str, Callable[[float], complex]] = {
    "backward_euler": backward_euler.mode_factor,
    "bdf2": bdf2.mode_factor,
}


def stage_solver(body: Body, h: float, method: MethodSpec) -> StageSolver:
    """Return what solves the implicit stages of size h [s]: as far as the method's law and iterations ask."""
    if body.law.constant_tangent:
        body.rehearse()
        return Prefactored(body, _linear_solver(body, h, method, constant=True), h)
    solver = _linear_solver(body, h, method, constant=False)
    auto = method.model == "auto"
    body.rehearse(turning=auto, tangents=not auto and method.iterations == "converged")
    limits = NewtonLimits(method.tolerance, method.max_iterations, cast(Tangent, method.tangent))
    if auto:
        # the linear rung keeps its factor, so it has a solver of its own
        linear = make_body(
            body.mesh, Linear(body.material), body.supports, body.load, body.mass_pairs, body.varying_load
        )
        linear.rehearse()
        prefactored = Prefactored(linear, _linear_solver(body, h, method, constant=True), h)
        newton = Converged(body, solver, limits)
        return Auto(body, prefactored, FrozenPasses(body, solver, 1), newton, method.volume_tolerance)
    if isinstance(method.iterations, int):
        return FrozenPasses(body, solver, method.iterations)
    return Converged(body, solver, limits)


def linear_solvers(body: Body, h: float, method: MethodSpec) -> list[dict[str, str]]:
    """Return name and reason of the linear solvers that a method uses on a body: none, one, or two for "auto"."""
    if method.stepper in STEP_LIMITS:
        return []
    if method.linear_solver == "pardiso" and library() is None:
        return [{"name": "superlu", "reason": "the case names pardiso; MKL is not installed"}]
    if method.linear_solver == "warped":
        kind = factor_kind(band_of(body.free_pattern).megabytes)
        return [{"name": "warped", "reason": f"the case names it; the factor at rest is {kind}"}]
    if method.linear_solver != "auto":
        return [{"name": method.linear_solver, "reason": "the case names it"}]
    kinds = [True, False] if method.model == "auto" else [body.law.constant_tangent]
    return [dict(zip(("name", "reason"), _choice(body, h, constant=one), strict=True)) for one in kinds]


def _linear_solver(body: Body, h: float, method: MethodSpec, *, constant: bool) -> LinearSolver:
    name = method.linear_solver if method.linear_solver != "auto" else _choice(body, h, constant=constant)[0]
    return LINEAR_SOLVERS[name](body.free_pattern, method.linear_rtol, _rest(body, h))


def _choice(body: Body, h: float, *, constant: bool) -> tuple[str, str]:
    return choice(body.free_pattern, constant=constant, stiffness=h * body.frequency_bound)


def _rest(body: Body, h: float) -> Rest:
    """Return the free nodes at rest, and what gives the values of M + h^2 K there."""

    def values() -> Floats:
        A = np.empty_like(body.mass)
        body.system(body.mesh.points, h, np.empty_like(body.mesh.points), A)
        return A[: body.free_pattern.blocks]

    return Rest(body.mesh.points[body.free], values)


def _treatment(body: Body, method: MethodSpec) -> Treatment | None:
    made = INVERSIONS[method.inversion]
    if made is None:
        return None
    polar(np.eye(body.mesh.dimension)[None])  # its kernel is compiled, or loaded, here
    return made()


def _guarded(stepper: Stepper, body: Body, method: MethodSpec) -> Stepper:
    """Return the stepper, watched unless its energy is bounded by construction."""
    if method.model == "auto":
        return EnergyGuard(body, stepper, from_rung=COROTATIONAL)
    bounded = body.law.constant_tangent or method.iterations == "converged"
    return stepper if bounded else EnergyGuard(body, stepper)


# what `pipeline methods` prints: table, its key in a case file, and a line for every name
DESCRIPTIONS: Mapping[str, Mapping[str, str]] = {
    "method.model": {
        "fixed": "law, rotation and iterations as the case gives them",
        "auto": "linear, corotational or converged, whichever a step needs to keep method.volume_tolerance",
    },
    "method.law": {
        "linear": "small strains and rotations; grows by 1/cos^2 of the angle; one factor for the whole run",
        "corotational": "linear elasticity in each cell's own rotated frame",
    },
    "method.rotation": {
        "polar": "closest rotation to F; independent of the axes; right for inverted and collapsed cells",
        "gram_schmidt": "the thesis' choice: cheap, depends on the order of the axes, has no potential",
    },
    "method.stepper": {
        "backward_euler": "implicit, order 1, L-stable, damps oscillations (32 % for the thesis' bar)",
        "bdf2": "implicit, order 2, L-stable, damps far less; remembers one state",
        "symplectic_euler": "explicit, order 1, no damping, no matrix; steps below a limit only (pipeline check)",
    },
    "method.iterations": {
        "1, 2, …": "solves a step, each with the rotations before it; 1 is the thesis' method",
        "converged": "Newton to method.tolerance; energy bounded; needs the polar rotation",
    },
    "method.tangent": {
        "projected": "for converged: always descends, exact near the end; the default",
        "exact": "for converged: quadratic near the solution, may fail in compression",
        "frozen": "for converged: the thesis' stiffness, linear convergence",
    },
    "method.mass": {
        "consistent": "the element's own mass matrix",
        "lumped": "the same mass on the nodes: a diagonal; what symplectic_euler takes",
    },
    "method.inversion": {
        "flip": "inverted cells: the smallest singular value is negative; no history",
        "last": "inverted cells: the rotation from before; for one solve",
        "crossing": "inverted cells: the direction that collapsed is negative; for one solve",
    },
    "method.linear_solver": {
        "auto": "by size: banded for small meshes, then warped, then multigrid; for the linear law pardiso or superlu",
        "warped": "conjugate gradients with the rest state's factor turned along, to method.linear_rtol; larger meshes",
        "multigrid": "as warped, with a multigrid cycle for the factor: less memory, quick set-up; large meshes",
        "banded": "Cholesky of the band, factors every new matrix; fastest on small meshes",
        "superlu": "sparse direct, factors every new matrix",
        "pardiso": "sparse direct by Intel MKL (the `mkl` extra; without it superlu), factors every new matrix",
        "cg": "conjugate gradients with block Jacobi to method.linear_rtol: for small steps",
    },
    "mesh.split": {
        "kuhn": "every cell along the same diagonal",
        "alternating": "every other cell mirrored: no bias of direction, less locking",
    },
    "mesh.shape": {"box": "tetrahedra, 6 a cell", "rectangle": "triangles, 2 a cell; plane strain"},
}
