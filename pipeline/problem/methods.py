"""The tables: the names that a case may use for the parts of its method, the parts themselves, and a line about each.

A new law, rotation, stepper, linear solver or shape is one file and one row here; `pipeline methods`, the schema and
the checks of a case read these tables.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from pipeline.case import MethodSpec
from pipeline.fem.body import Body
from pipeline.fem.laws import Corotational, Law, Linear
from pipeline.fem.mass import CONSISTENT_MASS, LUMPED_MASS, MassModel
from pipeline.fem.material import Material
from pipeline.fem.rotation import GRAM_SCHMIDT_ROTATION, POLAR_ROTATION, Rotation
from pipeline.linear.banded import BandedCholesky
from pipeline.linear.cg import make_block_jacobi_cg
from pipeline.linear.pardiso import make_pardiso_or_superlu
from pipeline.linear.rest_preconditioner import make_multigrid_cg, make_warped_cg
from pipeline.linear.solver import LinearSolver, SystemSettings
from pipeline.linear.superlu import SuperLU
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.simplex import Mesh
from pipeline.stepping import backward_euler, bdf2
from pipeline.stepping.backward_euler import BackwardEuler
from pipeline.stepping.bdf2 import BDF2
from pipeline.stepping.inversion import Crossing, Last, Treatment
from pipeline.stepping.parts import StepperParts
from pipeline.stepping.state import Stepper
from pipeline.stepping.symplectic_euler import SymplecticEuler, element_limit, true_limit

Part = TypeVar("Part")


@dataclass(frozen=True)
class Choice(Generic[Part]):
    """One row of a table: the part of a method, or the function that makes it, and a line that describes it."""

    part: Part
    description: str


@dataclass(frozen=True)
class LawChoice(Choice[Callable[[Material, Rotation], Law]]):
    """A law; a linear one needs no rotations and no iterations."""

    is_linear: bool = False


@dataclass(frozen=True)
class StepperChoice(Choice[Callable[[Body, float, StepperParts], Stepper]]):
    """A stepper, its order of accuracy, and whether it solves a system in every step."""

    order: int
    is_implicit: bool


@dataclass(frozen=True)
class ModelMode:
    """Whether each step chooses its own model; if so, the case's law, rotation and iterations are not used."""

    chooses_model: bool
    description: str


MODELS: Mapping[str, ModelMode] = {
    "fixed": ModelMode(False, "law, rotation and iterations as given in the case"),
    "auto": ModelMode(
        True, "linear, corotational or converged, whichever a step needs to stay within method.volume_tolerance"
    ),
}
LAWS: Mapping[str, LawChoice] = {
    "linear": LawChoice(
        lambda material, rotation: Linear(material),
        "for small strains and rotations: cells grow by 1/cos^2 of their rotation; one factorization for the whole run",
        is_linear=True,
    ),
    "corotational": LawChoice(Corotational, "linear elasticity in each cell's own rotated frame"),
}
ROTATIONS: Mapping[str, Choice[Rotation]] = {
    "polar": Choice(
        POLAR_ROTATION, "closest rotation to F; independent of the axes; right for inverted and collapsed cells"
    ),
    "gram_schmidt": Choice(
        GRAM_SCHMIDT_ROTATION, "the thesis' choice: cheap, depends on the order of the axes, has no potential"
    ),
}
ROTATION_SITES: Mapping[str, str] = {
    "points": "a rotation at every integration point",
    "element": "cells of order 2 have one rotation each: cheaper, inaccurate if cells bend; no potential",
}
VOLUMETRICS: Mapping[str, str] = {
    "full": "the dilatation of every integration point: cells lock as poisson_ratio approaches 0.5",
    "mean": "one dilatation for each cell of order 2, or group of cells of order 1: for poisson_ratio above 0.45",
}
STEPPERS: Mapping[str, StepperChoice] = {
    "backward_euler": StepperChoice(
        BackwardEuler.make,
        "implicit, order 1, L-stable, damps oscillations (32 % for the thesis' bar)",
        order=1,
        is_implicit=True,
    ),
    "bdf2": StepperChoice(
        BDF2.make,
        "implicit, order 2, L-stable, damps much less; needs the previous state",
        order=2,
        is_implicit=True,
    ),
    "symplectic_euler": StepperChoice(
        SymplecticEuler.make,
        "explicit, order 1, no damping, no matrix; stable only for steps below a limit (see pipeline check)",
        order=1,
        is_implicit=False,
    ),
}
IMPLICIT_STEPPERS = tuple(name for name, row in STEPPERS.items() if row.is_implicit)
# for steppers that are stable only below some step [s]: a cheap lower bound on the limit, and the limit itself
STEP_LIMITS: Mapping[str, tuple[Callable[[Body], float], Callable[[Body], float]]] = {
    "symplectic_euler": (element_limit, true_limit),
}
# the factor by which a step of an implicit stepper multiplies a mode of the linear law with z = omega dt and a damping
# ratio
MODE_FACTORS: Mapping[str, Callable[[float, float], complex]] = {
    "backward_euler": backward_euler.mode_factor,
    "bdf2": bdf2.mode_factor,
}
ITERATIONS: Mapping[str, str] = {
    "1, 2, …": "solves per step, each with the rotations that the previous one reached; 1 is the thesis' method",
    "converged": "Newton to method.tolerance; energy bounded; needs the polar rotation",
}
TANGENTS: Mapping[str, str] = {
    "projected": "for converged: always descends, exact near the end; the default",
    "exact": "for converged: quadratic near the solution, may fail in compression",
    "frozen": "for converged: the thesis' stiffness, linear convergence",
}
MASSES: Mapping[str, Choice[MassModel]] = {
    "consistent": Choice(CONSISTENT_MASS, "the element's own mass matrix"),
    "lumped": Choice(LUMPED_MASS, "the same mass on the nodes: a diagonal matrix; symplectic_euler needs it"),
}
# None: the law treats inverted cells itself
INVERSIONS: Mapping[str, Choice[Callable[[], Treatment] | None]] = {
    "flip": Choice(None, "inverted cells: the smallest singular value counts as negative; no history"),
    "last": Choice(Last, "inverted cells: keep the rotation from before the inversion; for one solve per step"),
    "crossing": Choice(
        Crossing, "inverted cells: the direction that collapsed counts as negative; for one solve per step"
    ),
}
# None: linear/choice.py chooses one of the others by size
LINEAR_SOLVERS: Mapping[str, Choice[Callable[[SystemSettings], LinearSolver] | None]] = {
    "auto": Choice(
        None, "by size: banded for small meshes, then warped, then multigrid; for the linear law pardiso or superlu"
    ),
    "warped": Choice(
        make_warped_cg,
        "conjugate gradients to method.linear_rtol, preconditioned by the rest state's factor rotated with the body",
    ),
    "multigrid": Choice(
        make_multigrid_cg,
        "like warped, with a multigrid cycle instead of the factor: less memory, quick set-up; large meshes",
    ),
    "banded": Choice(BandedCholesky, "Cholesky of the band, factors every new matrix; fastest on small meshes"),
    "superlu": Choice(SuperLU, "sparse direct, factors every new matrix"),
    "pardiso": Choice(
        make_pardiso_or_superlu,
        "sparse direct from Intel MKL (the `mkl` extra; without it superlu), factors every new matrix",
    ),
    "cg": Choice(make_block_jacobi_cg, "conjugate gradients with block Jacobi to method.linear_rtol: for small steps"),
}
SPLITS: Mapping[str, str] = {
    "kuhn": "every cell along the same diagonal",
    "alternating": "every other cell mirrored: no preferred direction, less locking",
}
SHAPES: Mapping[str, Choice[Callable[[Sequence[float], Sequence[int], str], Mesh]]] = {
    "box": Choice(box, "tetrahedra, 6 per cell"),
    "rectangle": Choice(rectangle, "triangles, 2 per cell; plane strain"),
}


def describe_choices() -> dict[str, dict[str, str]]:
    """Return the names that each key of a case file can take, with a line about each."""
    tables: Mapping[str, Mapping[str, Choice[Any] | ModelMode | str]] = {
        "method.model": MODELS,
        "method.law": LAWS,
        "method.rotation": ROTATIONS,
        "method.rotation_at": ROTATION_SITES,
        "method.volumetric": VOLUMETRICS,
        "method.stepper": STEPPERS,
        "method.iterations": ITERATIONS,
        "method.tangent": TANGENTS,
        "method.mass": MASSES,
        "method.inversion": INVERSIONS,
        "method.linear_solver": LINEAR_SOLVERS,
        "mesh.split": SPLITS,
        "mesh.shape": SHAPES,
    }
    return {
        key: {name: row if isinstance(row, str) else row.description for name, row in table.items()}
        for key, table in tables.items()
    }


@dataclass(frozen=True)
class MethodTraits:
    """Properties of a method, from its rows.

    `is_linear` and `is_converged` (Newton's method to a tolerance) apply only to methods that do not choose a model.
    """

    is_explicit: bool
    chooses_model: bool
    is_linear: bool
    is_converged: bool


def find_traits(method: MethodSpec) -> MethodTraits:
    """Return the properties of a method; its names must be in the tables."""
    chooses = MODELS[method.model].chooses_model
    return MethodTraits(
        is_explicit=not STEPPERS[method.stepper].is_implicit,
        chooses_model=chooses,
        is_linear=LAWS[method.law].is_linear and not chooses,
        is_converged=method.iterations == "converged" and not chooses,
    )
