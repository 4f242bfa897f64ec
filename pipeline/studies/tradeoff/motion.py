"""One setting run in memory: the motion of its nodes, and its cost."""

import base64
import statistics
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrays import Floats
from pipeline.case import Case
from pipeline.errors import SolveError
from pipeline.linear.work import Work
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.problem.problem import Problem, build
from pipeline.results.variant_run import result_settings
from pipeline.run.frame import Frame
from pipeline.run.frame_iterator import frames
from pipeline.run.measures import measure_cells

COUNTS = ("steps", "solves", "iterations", "factorizations", "rotations")
_ENERGIES = ("kinetic_energy", "elastic_energy", "potential_energy")
_LEAST_SECONDS, _MOST_SECONDS = 0.5, 5.0  # of all repeats: below the first there are more, above the second no more
_MOST_RUNS, _PAIRS = 15, 9  # repeats at most, and pairs of a race
_MOST_SIZES = 1e3  # a body that moves this many times its size has no meaningful error


def make_task_settings(case: Case, repeats: int) -> dict[str, Any]:
    """Return the settings of `run_motion` for a resolved case, with a hash of its mesh file."""
    settings = {"case": result_settings(case), "path": str(case.path.resolve()), "repeats": repeats}
    if case.mesh_path is not None:
        settings["mesh_file"] = _hash_file(case, case.mesh_path)
    return settings


def _hash_file(case: Case, path: Path) -> str:
    try:
        return sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise case.make_error("mesh.file", f"{path}: cannot be read ({error.strerror})") from error


def run_motion(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return displacement and velocity at every frame (packed), energies, work counts and solver seconds.

    The run is repeated as often as the settings say, but more often if short and less often if long; seconds are the
    median. Raises SolveError if a step fails or the body moves absurdly far.
    """
    problem = build_problem(settings, "case")
    problem.prepare().step(problem.start)  # loads the kernels now, not in the first timed step
    seconds: list[float] = []
    setup: list[float] = []
    repeats = settings["repeats"]
    while (len(seconds) < repeats and sum(seconds) < _MOST_SECONDS) or (repeats > 1 and _are_too_short(seconds)):
        seen = list(frames(problem))
        setup.append((seen[0].work or Work()).seconds)
        total = _sum_step_work(seen)
        seconds.append(total.seconds)
    X, size = problem.body.mesh.points, problem.body.mesh.size
    u = np.stack([frame.x - X for frame in seen])
    if np.abs(u).max() > _MOST_SIZES * size:
        raise SolveError(f"moved by {np.abs(u).max() / size:.3g} times its size")
    return {
        "displacement": pack_array(u),
        "velocity": pack_array(np.stack([frame.v for frame in seen if frame.v is not None])),
        "shape": u.shape,
        **{name: [float(frame.known[name]) for frame in seen] for name in _ENERGIES},
        "seconds": statistics.median(seconds),
        "setup_seconds": statistics.median(setup),
        "repeats": len(seconds),
        "work": {name: getattr(total, name) for name in COUNTS},
        "indicator": max((float(frame.known.get("indicator", 0.0)) for frame in seen), default=0.0),
        "rung": max((int(frame.known.get("rung", 0)) for frame in seen), default=0),
    }


def run_race(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the ratio of solver seconds of "case" over those of "rival", run in turn: the median of the pairs.

    Other work on the machine slows both, so the ratio is more accurate than either time.
    """
    problems = [build_problem(settings, key) for key in ("case", "rival")]
    for problem in problems:
        problem.prepare().step(problem.start)
    pairs: list[tuple[float, float]] = []
    while len(pairs) < _PAIRS or _are_too_short([first for first, _ in pairs]):
        first, second = (_sum_step_work(list(frames(problem))).seconds for problem in problems)
        pairs.append((first, second))
    return {"ratio": statistics.median(first / second for first, second in pairs), "pairs": len(pairs)}


def build_problem(settings: Mapping[str, Any], key: str) -> Problem:
    """Return the problem of the case under a key of the settings."""
    return build(Case.model_validate({**settings[key], "path": Path(settings["path"])}))


def _sum_step_work(seen: list[Frame]) -> Work:
    """Return the work of all steps; that of the first frame is the set-up."""
    return sum((frame.work or Work() for frame in seen[1:]), Work())


def _are_too_short(seconds: list[float]) -> bool:
    """Return whether runs were too short, and too few, for a median on a busy machine."""
    return sum(seconds) < _LEAST_SECONDS and len(seconds) < _MOST_RUNS


def pack_array(values: Floats) -> str:
    """Return an array as text, in single precision: relative errors of 1e-7 are far below any error of a study."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


def unpack_array(text: str, shape: tuple[int, ...]) -> Floats:
    """Return the array packed as text."""
    return np.frombuffer(base64.b64decode(text), dtype="<f4").astype(np.float64).reshape(shape)


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """Displacements and velocities (t, n, d) of a mesh, its total energy (t,) [J], and that without the loads' part."""

    mesh: ElementMesh
    u: Floats
    v: Floats
    energy: Floats
    moving_energy: Floats

    @cached_property
    def ratios(self) -> Floats:
        """Return the volume ratio of every cell at every instant (t, e)."""
        X = self.mesh.points
        return np.stack([measure_cells(self.mesh, X + u).volumes for u in self.u]) / self.mesh.rest_volumes

    @cached_property
    def drift(self) -> Floats:
        """Return the total volume over that at rest, less one (t,)."""
        rest = self.mesh.rest_volumes
        return np.asarray(self.ratios @ rest / rest.sum() - 1)


def read_motion(result: Mapping[str, Any], mesh: ElementMesh) -> RecordedMotion:
    """Return the motion of a result of `run_motion`."""
    shape = tuple(result["shape"])
    kinetic, elastic, potential = (np.array(result[name]) for name in _ENERGIES)
    u, v = (unpack_array(result[name], shape) for name in ("displacement", "velocity"))
    return RecordedMotion(mesh, u, v, kinetic + elastic + potential, kinetic + elastic)
