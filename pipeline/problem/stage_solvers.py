"""Steppers made from a method: their stage solvers, linear solvers and treatments, from the tables in methods.py."""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.case import MethodSpec
from pipeline.fem.body import Body
from pipeline.fem.body_choice import make_body
from pipeline.fem.laws import Linear, Tangent
from pipeline.fem.rotation import polar
from pipeline.linear.band import Band
from pipeline.linear.choice import choose_solver
from pipeline.linear.pardiso import load_mkl
from pipeline.linear.rest_preconditioner import choose_rest_factor
from pipeline.linear.solver import LinearSolver, RestState, SystemSettings
from pipeline.mesh.quadratic import find_side_ends
from pipeline.problem.methods import INVERSIONS, LINEAR_SOLVERS, STEPPERS, find_traits
from pipeline.stepping.auto import Auto
from pipeline.stepping.damping import FrozenDamping
from pipeline.stepping.energy_guard import EnergyGuard
from pipeline.stepping.inversion import Treatment
from pipeline.stepping.newton import Converged, NewtonLimits
from pipeline.stepping.stage import FrozenPasses, Prefactored, StageSolver
from pipeline.stepping.state import Stepper


@dataclass(frozen=True, eq=False)
class MethodParts:
    """Makes the stepper parts that a method names."""

    body: Body
    method: MethodSpec

    def make_stage_solver(self, h: float) -> StageSolver:
        """Return a new solver of implicit stages of size h [s]."""
        return make_stage_solver(self.body, h, self.method)

    def make_treatment(self) -> Treatment | None:
        """Return the treatment of inverted cells, None if the law treats them itself."""
        make = INVERSIONS[self.method.inversion].part
        if make is None:
            return None
        polar(np.eye(self.body.mesh.dimension)[None])  # its kernel is compiled or loaded here
        return make()


def make_stepper(body: Body, dt: float, method: MethodSpec) -> Stepper:
    """Return the stepper of a method, watched by the energy guard unless its energy is bounded by construction."""
    traits = find_traits(method)
    stepper = STEPPERS[method.stepper].part(body, dt, MethodParts(body, method))
    converges = body.law.constant_tangent or traits.is_converged
    bounded = converges and not traits.is_explicit and not traits.chooses_model
    return stepper if bounded else EnergyGuard(body, stepper)


def make_stage_solver(body: Body, h: float, method: MethodSpec) -> StageSolver:
    """Return the solver of implicit stages of size h [s] that the body's law and the method's iterations need."""
    systems, stiffness = _describe_systems(body, h, method), _find_stiffness(body, h)
    if body.law.constant_tangent:
        body.warm_up()
        return Prefactored(body, _make_linear_solver(systems, stiffness, method, constant=True), h)
    traits = find_traits(method)
    solver = _make_linear_solver(systems, stiffness, method, constant=False)
    body.warm_up(frame_errors=traits.chooses_model, tangents=traits.is_converged)
    limits = NewtonLimits(method.tolerance, method.max_iterations, cast(Tangent, method.tangent))
    if traits.chooses_model:
        # the linear rung keeps its factor, so it has a solver of its own
        linear = make_body(
            body.mesh,
            Linear(body.material),
            body.supports,
            body.load,
            body.mass_model,
            body.varying_load,
            body.formulation,
        )
        linear = replace(linear, damping=body.damping)
        linear.warm_up()
        prefactored = Prefactored(linear, _make_linear_solver(systems, stiffness, method, constant=True), h)
        newton = Converged(body, solver, limits)
        # damping holds back the stress that shrinks a swollen cell: it keeps up to 1 + beta/h times the volume
        slow = 1.0 if body.damping is None else 1 + body.damping.stiffness / h
        return Auto(body, prefactored, FrozenPasses(body, solver, 1), newton, method.volume_tolerance / slow)
    if isinstance(method.iterations, int):
        return FrozenPasses(body, solver, method.iterations)
    return Converged(body, solver, limits)


def list_linear_solvers(body: Body, h: float, method: MethodSpec) -> list[dict[str, str]]:
    """Return name and reason of the linear solvers that a method uses on a body: none if it is explicit.

    A method that chooses its model has two, one for the linear law and one for the others.
    """
    traits = find_traits(method)
    if traits.is_explicit:
        return []
    if method.linear_solver == "pardiso" and load_mkl() is None:
        return [{"name": "superlu", "reason": "the case names pardiso; MKL is not installed"}]
    band = Band(body.free_pattern)
    if method.linear_solver == "warped":
        kind = choose_rest_factor(band)
        return [{"name": "warped", "reason": f"the case names it; the factor at rest is {kind}"}]
    if LINEAR_SOLVERS[method.linear_solver].part is not None:
        return [{"name": method.linear_solver, "reason": "the case names it"}]
    kinds = [True, False] if traits.chooses_model else [body.law.constant_tangent]
    stiffness, order = _find_stiffness(body, h), body.mesh.order
    choices = [choose_solver(band, constant=kind, stiffness=stiffness, order=order) for kind in kinds]
    return [{"name": name, "reason": reason} for name, reason in choices]


def _find_stiffness(body: Body, h: float) -> float:
    """Return a bound on h omega_max [1]; with damping, of the h for which M + h^2 K is as stiff as the matrix."""
    return (h if body.damping is None else body.damping.stiffen(h)) * body.frequency_bound


def _make_linear_solver(
    systems: SystemSettings, stiffness: float, method: MethodSpec, *, constant: bool
) -> LinearSolver:
    make = LINEAR_SOLVERS[method.linear_solver].part
    if make is None:
        name, _ = choose_solver(systems.band, constant=constant, stiffness=stiffness, order=systems.rest.order)
        make = LINEAR_SOLVERS[name].part
        assert make is not None  # choose_solver names only rows that have one
    return make(systems)


def _describe_systems(body: Body, h: float, method: MethodSpec) -> SystemSettings:
    """Return the systems of a body's free nodes; the state at rest has the matrix M + h C + h^2 K."""

    def assemble() -> Floats:
        A = np.empty_like(body.mass)
        body.assemble_system(body.mesh.points, h, np.empty_like(body.mesh.points), A)
        if body.damping is not None:
            damping = FrozenDamping(body, body.damping)
            damping.freeze(body.mesh.points, h)
            A += damping.values
        if body.guide_cut is not None:
            body.guide_cut.apply(A)
        return A[: body.free_pattern.blocks]

    def find_ends() -> Ints:
        number = np.full(len(body.mesh.points), -1)
        number[body.free] = np.arange(len(body.free))
        return number[find_side_ends(body.mesh)[body.free]]

    is_held = None if body.guide_cut is None else body.guide_cut.is_held
    rest = RestState(body.mesh.points[body.free], assemble, find_ends if body.mesh.order == 2 else None, is_held)
    return SystemSettings(body.free_pattern, method.linear_rtol, rest)
