"""One method at one extreme and its outcome: a pure function from plain settings to plain numbers."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from pipeline.arrays import Floats
from pipeline.case import Case, load_case
from pipeline.errors import CaseError, MeshError, SolveError
from pipeline.fem.element import deformation_gradient
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.quadratic import make_quadratic_mesh
from pipeline.mesh.simplex import Mesh, signed_volumes
from pipeline.problem.methods import STEP_LIMITS
from pipeline.problem.problem import Problem, build
from pipeline.run.frame import Frame
from pipeline.run.frame_iterator import frames
from pipeline.stepping.energy_guard import natural_energy, work_of_supports, work_of_varying_load
from pipeline.stepping.state import State
from pipeline.studies.stability.perturbations import move_apexes, scramble_nodes

OUTCOMES: Mapping[str, str] = {
    "survives": "finite, energy bounded, volumes and positions within the tolerance",
    "wrong_motion": "volumes within the tolerance, positions or energy not",
    "wrong_volume": "finite, but volumes are not within the tolerance",
    "not_judged": "finite, but the converged reference run failed",
    "solve_error": "stopped by an error that names the step",
    "refused": "an error before the first step",
    "unexpected_error": "any other error: a fault of the program",
}
SURVIVES, WRONG_MOTION, WRONG_VOLUME, NOT_JUDGED, SOLVE_ERROR, REFUSED, UNEXPECTED = OUTCOMES
_MOST_GROWTH = 10.0  # energy over that of start, loads and supports: the limit of the energy guard
# all methods at a value have the same reference, which a worker runs once for its share of them
_CACHED_REFERENCES = 8
NO_RUN: Mapping[str, Any] = {
    "steps": 0, "iterations": 0, "worst_volume_ratio": 1.0, "energy_growth": 1.0, "volume_error": 0.0,
    "node_distance": 0.0, "message": "",
}  # fmt: skip


@dataclass
class Course:
    """The course of a run: positions x (n, d) [m] at its start and after every step, and the error that ended it."""

    mesh: ElementMesh
    is_held: bool
    x: list[Floats] = field(default_factory=list)
    iterations: int = 0
    energy_growth: float = 0.0
    message: str = ""

    def compute_ratios(self, step: int) -> Floats:
        """Return J of every cell (e,) after a step; of order 2, det F at every integration point (p,)."""
        if self.mesh.order == 1:
            return signed_volumes(self.x[step], self.mesh.cells) / self.mesh.rest_volumes
        return np.asarray(np.linalg.det(deformation_gradient(self.mesh, self.x[step])))

    def find_worst_ratio(self) -> float:
        """Return the J of any cell and step that is farthest from 1."""
        extremes = np.array([(J.min(), J.max()) for J in map(self.compute_ratios, range(len(self.x)))]).ravel()
        return float(extremes[np.abs(extremes - 1).argmax()])


def run_trial(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the outcome of a method at an extreme and the numbers behind it, all of them finite.

    outcome             one of OUTCOMES except the last, which only the sweep can find; an error has its message
    worst_volume_ratio  the J farthest from 1 after any step
    energy_growth       the largest kinetic + elastic energy over that supplied by start, loads and supports
    volume_error        the largest |J - J_reference|
    node_distance       the largest |x - x_reference| over the body's size
    """
    try:
        course = _run_problem(_build_trial(settings, settings["method"]))
    except (CaseError, MeshError) as error:
        return {**NO_RUN, "outcome": REFUSED, "message": str(error).removeprefix(f"{settings['case']}: ")}
    numbers = {
        "steps": len(course.x) - 1 if course.x else 0,
        "iterations": course.iterations,
        "worst_volume_ratio": course.find_worst_ratio() if course.x else 1.0,
        "energy_growth": course.energy_growth,
        "message": course.message,
    }
    errors = (
        _compare_with_rest(course) if settings["reference"] == "rest" else _compare_with_reference(course, settings)
    )
    return {**NO_RUN, **numbers, **errors, "outcome": _judge_outcome(course, errors, settings["tolerance"])}


def _judge_outcome(course: Course, errors: Mapping[str, float], tolerance: float) -> str:
    if course.message:
        return SOLVE_ERROR
    if not errors:
        return NOT_JUDGED
    if errors["volume_error"] > tolerance:
        return WRONG_VOLUME
    return SURVIVES if errors["node_distance"] <= tolerance and course.energy_growth <= _MOST_GROWTH else WRONG_MOTION


def _make_case(settings: Mapping[str, Any], changes: Mapping[str, Any]) -> Case:
    """Return the case with the changes as its only variant."""
    overrides = {**settings["scene"], "movie": {}, "variants": {"trial": {**settings["changes"], **changes}}}
    return load_case(settings["case"], overrides=overrides).variant("trial")


def _build_trial(settings: Mapping[str, Any], method: Mapping[str, Any]) -> Problem:
    """Return the problem of a trial, solved by that method; raises CaseError or MeshError if refused."""
    changes = {f"method.{key}": value for key, value in method.items()}
    disturbance, seed = settings["disturbance"], settings["seed"]
    mesh = None
    if settings["limit_share"] is not None or "sliver" in disturbance:
        # built with a stepper for which no step is too long
        plain = build(_make_case(settings, changes | {"method.stepper": "backward_euler", "method.law": "linear"}))
        if "sliver" in disturbance:
            rest, free = plain.body.mesh, plain.body.free
            mesh = _move_points(rest, move_apexes(rest, free, 1 - disturbance["sliver"], seed=seed))
        if settings["limit_share"] is not None:
            bound, _ = STEP_LIMITS[settings["method"]["stepper"]]  # of the trial, also for its reference
            limit = bound(replace(plain.body, mesh=mesh or plain.body.mesh))
            changes["schedule.dt"] = settings["limit_share"] * limit
    problem = build(_make_case(settings, changes), mesh=mesh)
    rest, free, start = problem.body.mesh, problem.body.free, problem.start
    if "scramble" in disturbance:
        x = scramble_nodes(rest, free, disturbance["scramble"], seed=seed)
    elif "inversion" in disturbance:
        x = move_apexes(rest, free, 1 + disturbance["inversion"], seed=seed)
    else:
        return problem
    return replace(problem, start=State(0, x, start.v))


def _move_points(mesh: ElementMesh, points: Floats) -> ElementMesh:
    """Return a mesh of the same cells with other points (n, d); raises MeshError if cells are inverted or folded."""
    make = Mesh if mesh.order == 1 else make_quadratic_mesh
    return make(points, mesh.cells, mesh.name, mesh.notes)


def _run_problem(problem: Problem) -> Course:
    """Return the course of a problem's run; a SolveError becomes its message."""
    body = problem.body
    course = Course(body.mesh, is_held=bool(body.supports.nodes.size))
    supplied, before = 0.0, None
    try:
        for frame in frames(problem):
            energy = float(frame.known["kinetic_energy"] + frame.known["elastic_energy"])
            from_loads = abs(float(frame.known["potential_energy"]))
            supplied += energy + from_loads if before is None else _measure_work(problem, before, frame)
            growth = energy / max(supplied + from_loads, natural_energy(body))
            course.energy_growth = max(course.energy_growth, growth)
            course.iterations += frame.work.iterations if frame.work else 0
            course.x.append(frame.x)
            before = frame
    except SolveError as error:
        course.message = str(error)
    return course


def _measure_work(problem: Problem, before: Frame, after: Frame) -> float:
    """Return the work [J] of supports and of loads that vary; the potential has that of the others."""
    assert before.state is not None and after.state is not None
    work = work_of_supports(problem.body, before.state, after.state, problem.dt)
    return work + work_of_varying_load(problem.body, before.state, after.state, problem.dt)


@lru_cache(maxsize=_CACHED_REFERENCES)
def _run_reference(text: str) -> Course:
    """Return the converged reference run of the trial with these settings, as JSON; bdf2 for an explicit method."""
    settings = json.loads(text)
    is_explicit = settings["method"]["stepper"] in STEP_LIMITS
    converged = {
        key: value for key, value in settings["method"].items() if key in ("stepper", "mass")
    } | {"law": "corotational", "rotation": "polar", "iterations": "converged"}  # fmt: skip
    return _run_problem(_build_trial(settings, converged | ({"stepper": "bdf2"} if is_explicit else {})))


def _compare_with_reference(course: Course, settings: Mapping[str, Any]) -> dict[str, float]:
    """Return the errors against the converged run of the same steps; {} if that failed earlier than this one."""
    stepper = {key: settings["method"][key] for key in ("stepper", "mass") if key in settings["method"]}
    reference = _run_reference(json.dumps({**settings, "method": stepper}, sort_keys=True))
    if len(reference.x) < len(course.x):
        return {}
    steps = range(len(course.x))
    volume_errors = [np.abs(course.compute_ratios(i) - reference.compute_ratios(i)).max() for i in steps]
    distances = [np.linalg.norm(course.x[i] - reference.x[i], axis=1).max() for i in steps]
    return {
        "volume_error": float(max(volume_errors, default=0.0)),
        "node_distance": float(max(distances, default=0.0)) / course.mesh.size,
    }


def _compare_with_rest(course: Course) -> dict[str, float]:
    """Return the errors of the run's end against the rest shape; for a free body, those of the volumes only."""
    if not course.x:
        return {"volume_error": 0.0, "node_distance": 0.0}
    distance = np.linalg.norm(course.x[-1] - course.mesh.points, axis=1).max() if course.is_held else 0.0
    return {
        "volume_error": float(np.abs(course.compute_ratios(len(course.x) - 1) - 1).max()),
        "node_distance": float(distance) / course.mesh.size,
    }
