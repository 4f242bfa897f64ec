"""One method at one extreme: what became of it. A pure function from plain settings to plain numbers."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from pipeline.arrays import Floats
from pipeline.case import Case, load_case
from pipeline.errors import CaseError, MeshError, SolveError
from pipeline.mesh.simplex import Mesh, signed_volumes
from pipeline.problem.problem import Problem, build
from pipeline.run.frame import Frame
from pipeline.run.frames import frames
from pipeline.stepping.energy_guard import natural_energy, work_of_supports
from pipeline.stepping.state import State
from pipeline.stepping.symplectic_euler import element_limit
from pipeline.studies.stability.perturbations import move_apexes, scramble_nodes
from pipeline.studies.stability.slices import EXPLICIT

OUTCOMES: Mapping[str, str] = {
    "survives": "finite, energy bounded, volumes and positions within the tolerance",
    "wrong_motion": "volumes within the tolerance, positions or energy not",
    "wrong_volume": "finite, but volumes are not within the tolerance",
    "not_judged": "finite, but the converged run that it is judged by failed",
    "solve_error": "stopped by an error that names the step",
    "refused": "an error before the first step",
    "unexpected_error": "neither: a fault of the program",
}
SURVIVES, WRONG_MOTION, WRONG_VOLUME, NOT_JUDGED, SOLVE_ERROR, REFUSED, UNEXPECTED = OUTCOMES
# of energy over what start, loads and supports brought: as the energy guard has it
_BOUNDED = 10.0
# the same reference judges every method at a value: a worker that gets some of them makes it once
_REFERENCES_KEPT = 8
NOTHING: Mapping[str, Any] = {
    "steps": 0, "iterations": 0, "worst_volume_ratio": 1.0, "energy_growth": 1.0, "volume_error": 0.0,
    "node_distance": 0.0, "message": "",
}  # fmt: skip


@dataclass
class Course:
    """How a run went: the positions x (n, d) [m] at its start and after every step, and why it ended early, if so."""

    mesh: Mesh
    held: bool
    x: list[Floats] = field(default_factory=list)
    iterations: int = 0
    energy_growth: float = 0.0
    message: str = ""

    def volume_ratios(self, step: int) -> Floats:
        """Return J of every cell (e,) after a step."""
        return signed_volumes(self.x[step], self.mesh.cells) / self.mesh.rest_volumes

    def worst_volume_ratio(self) -> float:
        """Return the J that was farthest from 1 at any time."""
        extremes = np.array([(J.min(), J.max()) for J in map(self.volume_ratios, range(len(self.x)))]).ravel()
        return float(extremes[np.abs(extremes - 1).argmax()])


def run_trial(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the outcome of a method at an extreme, and the numbers that it was judged by; all are finite.

    outcome             one of OUTCOMES, the last of which is not told here; an error with its message
    worst_volume_ratio  the J farthest from 1, of the steps that were made; energy_growth the largest kinetic + elastic
                        energy over what start, loads and supports brought
    volume_error        the largest |J - J_reference|, node_distance the largest |x - x_reference| over the size
    """
    try:
        course = _run_problem(_build_trial(settings, settings["method"]))
    except (CaseError, MeshError) as error:
        return {**NOTHING, "outcome": REFUSED, "message": str(error).removeprefix(f"{settings['case']}: ")}
    found = {
        "steps": len(course.x) - 1 if course.x else 0,
        "iterations": course.iterations,
        "worst_volume_ratio": course.worst_volume_ratio() if course.x else 1.0,
        "energy_growth": course.energy_growth,
        "message": course.message,
    }
    errors = _compare_with_rest(course) if settings["judged"] == "rest" else _compare_with_reference(course, settings)
    return {**NOTHING, **found, **errors, "outcome": _judge_outcome(course, errors, settings["tolerance"])}


def _judge_outcome(course: Course, errors: Mapping[str, float], tolerance: float) -> str:
    if course.message:
        return SOLVE_ERROR
    if not errors:
        return NOT_JUDGED
    if errors["volume_error"] > tolerance:
        return WRONG_VOLUME
    return SURVIVES if errors["node_distance"] <= tolerance and course.energy_growth <= _BOUNDED else WRONG_MOTION


def _make_case(settings: Mapping[str, Any], changes: Mapping[str, Any]) -> Case:
    """Return the case with one variant, the changed one."""
    overrides = {**settings["scene"], "movie": {}, "variants": {"trial": {**settings["changes"], **changes}}}
    return load_case(settings["case"], overrides=overrides).variant("trial")


def _build_trial(settings: Mapping[str, Any], method: Mapping[str, Any]) -> Problem:
    """Return the problem of a trial, solved by that method; raises CaseError or MeshError where it is refused."""
    changes = {f"method.{key}": value for key, value in method.items()}
    disturbance, seed = settings["disturbance"], settings["seed"]
    mesh = None
    if settings["limit_share"] is not None or "sliver" in disturbance:
        # by a stepper that no step is too long for
        plain = build(_make_case(settings, changes | {"method.stepper": "backward_euler", "method.law": "linear"}))
        if "sliver" in disturbance:
            rest, free = plain.body.mesh, plain.body.free
            mesh = replace(rest, points=move_apexes(rest, free, 1 - disturbance["sliver"], seed=seed))
        if settings["limit_share"] is not None:
            limit = element_limit(replace(plain.body, mesh=mesh or plain.body.mesh))
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


def _run_problem(problem: Problem) -> Course:
    """Return how the problem's run went, a SolveError kept as its message."""
    body = problem.body
    course = Course(body.mesh, held=bool(body.supports.nodes.size))
    brought, before = 0.0, None
    try:
        for frame in frames(problem):
            energy = float(frame.known["kinetic_energy"] + frame.known["elastic_energy"])
            from_loads = abs(float(frame.known["potential_energy"]))
            brought += energy + from_loads if before is None else _measure_supports_work(problem, before, frame)
            growth = energy / max(brought + from_loads, natural_energy(body))
            course.energy_growth = max(course.energy_growth, growth)
            course.iterations += frame.work.iterations if frame.work else 0
            course.x.append(frame.x)
            before = frame
    except SolveError as error:
        course.message = str(error)
    return course


def _measure_supports_work(problem: Problem, before: Frame, after: Frame) -> float:
    assert before.state is not None and after.state is not None
    return work_of_supports(problem.body, before.state, after.state, problem.dt)


@lru_cache(maxsize=_REFERENCES_KEPT)
def _run_reference(text: str) -> Course:
    """Return the converged run that the trial with these settings, as JSON, is judged by."""
    settings = json.loads(text)
    explicit = settings["method"]["stepper"] == EXPLICIT
    converged = {
        key: value for key, value in settings["method"].items() if key in ("stepper", "mass")
    } | {"law": "corotational", "rotation": "polar", "iterations": "converged"}  # fmt: skip
    return _run_problem(_build_trial(settings, converged | ({"stepper": "bdf2"} if explicit else {})))


def _compare_with_reference(course: Course, settings: Mapping[str, Any]) -> dict[str, float]:
    """Return the errors against the converged run of the same steps; {} where that failed before this run's end."""
    stepper = {key: settings["method"][key] for key in ("stepper", "mass") if key in settings["method"]}
    reference = _run_reference(json.dumps({**settings, "method": stepper}, sort_keys=True))
    if len(reference.x) < len(course.x):
        return {}
    steps = range(len(course.x))
    J = [np.abs(course.volume_ratios(i) - reference.volume_ratios(i)).max() for i in steps]
    away = [np.linalg.norm(course.x[i] - reference.x[i], axis=1).max() for i in steps]
    return {
        "volume_error": float(max(J, default=0.0)),
        "node_distance": float(max(away, default=0.0)) / course.mesh.size,
    }


def _compare_with_rest(course: Course) -> dict[str, float]:
    """Return the errors of the run's end against the rest shape; where nothing is held, that of the volumes alone."""
    if not course.x:
        return {"volume_error": 0.0, "node_distance": 0.0}
    away = np.linalg.norm(course.x[-1] - course.mesh.points, axis=1).max() if course.held else 0.0
    return {
        "volume_error": float(np.abs(course.volume_ratios(len(course.x) - 1) - 1).max()),
        "node_distance": float(away) / course.mesh.size,
    }
