"""The numbers of a problem that are known before it is solved."""

from cmath import log, phase
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from pipeline.errors import SolveError
from pipeline.fem.damping import find_mode_root
from pipeline.fem.modes import find_lowest_frequencies
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.simplex import label_components, measure_quality
from pipeline.problem.loads import format_total
from pipeline.problem.methods import MODE_FACTORS
from pipeline.problem.problem import Problem
from pipeline.stepping.symplectic_euler import element_limit, true_limit

# cells of order 1, or as many nodes; the eigenvalues of larger bodies take longer than most runs
_MODE_LIMIT = 200_000
_HUNDREDTH = 0.01  # of critical damping, and of a period: above these a smaller dt is suggested


@dataclass(frozen=True)
class Check:
    """Counts, volumes [m3], quality (1 is regular), speed of pressure waves [m/s] and lowest frequency omega_1 [rad/s].

    z is omega_1 dt, `material_damping` the damping ratio of that mode; `damping`, its ratio in steps, and `phase_lag`
    [degrees per period] are NaN for symplectic Euler, which is stable below `explicit_limit` [s] and, by a bound over
    the cells, `explicit_bound` [s].
    """

    dimension: int
    nodes: int
    cells: int
    held: int
    guided: int
    components: int
    total_volume: float
    smallest_volume: float
    largest_volume: float
    mass: float
    worst_quality: float
    worst_cell: int
    median_quality: float
    wave_speed: float
    omega_1: float
    z: float
    material_damping: float
    damping: float
    phase_lag: float
    explicit_bound: float
    explicit_limit: float


def check_problem(problem: Problem) -> Check:
    """Return the numbers of a problem; omega_1 is NaN if the body is too large to compute it, or rigid."""
    body = problem.body
    mesh = body.mesh
    q = measure_quality(mesh)
    omega = _lowest(problem)
    z = omega * problem.dt
    zeta = 0.0 if body.damping is None else body.damping.damping_ratio(omega)
    mode_factor = MODE_FACTORS.get(problem.method.stepper, lambda z, zeta: complex("nan"))
    return Check(
        dimension=mesh.dimension,
        nodes=len(mesh.points),
        cells=len(mesh.cells),
        held=len(body.supports.nodes),
        guided=0 if body.guide_cut is None else len(body.guide_cut.rows),
        components=label_components(mesh)[0],
        total_volume=float(mesh.rest_volumes.sum()),
        smallest_volume=float(mesh.rest_volumes.min()),
        largest_volume=float(mesh.rest_volumes.max()),
        mass=float(body.lumped_mass.sum()),
        worst_quality=float(q.min()),
        worst_cell=int(q.argmin()),
        median_quality=float(np.median(q)),
        wave_speed=body.material.wave_speed,
        omega_1=omega,
        z=z,
        material_damping=zeta,
        damping=_damping(mode_factor, z, zeta),
        phase_lag=_phase_lag(mode_factor, z, zeta),
        explicit_bound=element_limit(body),
        explicit_limit=_limit(problem),
    )


def _is_large(mesh: ElementMesh) -> bool:
    return len(mesh.cells) * 2 ** (mesh.dimension * (mesh.order - 1)) > _MODE_LIMIT


def _lowest(problem: Problem) -> float:
    if _is_large(problem.body.mesh):
        return float("nan")
    try:
        frequencies, _ = find_lowest_frequencies(problem.body)
    except SolveError:
        return float("nan")
    return float(frequencies[0]) if len(frequencies) else float("nan")


def _limit(problem: Problem) -> float:
    if _is_large(problem.body.mesh):
        return float("nan")
    return true_limit(problem.body)


def format_check(check: Check, problem: Problem) -> list[str]:
    """Return the numbers as lines of text."""
    kind, unit = ("tetrahedra", "m3") if check.dimension == 3 else ("triangles", "m2")
    order = f" of order {problem.body.mesh.order}" if problem.body.mesh.order > 1 else ""
    rows = [
        f"nodes        {check.nodes}, of which {check.held} are held"
        + (f", {check.guided} along some axes only" if check.guided else ""),
        f"{kind:<12} {check.cells}{order} in {check.components} component{'s' * (check.components > 1)}",
        f"volume       {check.total_volume:.6g} {unit}; "
        f"cells from {check.smallest_volume:.4g} to {check.largest_volume:.4g}",
        f"quality      worst {check.worst_quality:.3f} (cell {check.worst_cell}), "
        f"median {check.median_quality:.3f}; 1 is regular",
        f"mass         {check.mass:.6g} kg; pressure waves travel at {check.wave_speed:.4g} m/s",
    ]
    end = problem.last_step * problem.dt
    rows += [f"load         {format_total(total, end)}" for total in problem.loads]
    if np.isfinite(check.omega_1):
        rows += [
            f"omega_1      {check.omega_1:.4g} rad/s, the lowest elastic one ({check.omega_1 / 2 / np.pi:.4g} Hz)",
            f"omega_1 dt   {check.z:.4g} with dt = {problem.dt:g} s",
        ]
        rows += _format_mode(check, problem.method.stepper)
    limit = (
        f"{check.explicit_limit:.4g} s"
        if np.isfinite(check.explicit_limit)
        else "a step not computed for so many cells"
    )
    rows.append(
        f"explicit     symplectic Euler is stable below {limit}; "
        f"the bound over the cells is {check.explicit_bound:.4g} s"
    )
    rows += [f"note         {note}" for note in problem.notes]
    return rows


def _format_mode(check: Check, stepper: str) -> list[str]:
    """Return damping and lag of the lowest mode, with the steps that would bring each down to a hundredth."""
    if stepper not in MODE_FACTORS:
        return []
    zeta = check.material_damping
    damping = f"{stepper} damps that mode by {100 * check.damping:.3g} % of critical"
    if zeta:
        damping = f"the material damps that mode by {100 * zeta:.3g} % of critical, with {stepper} "
        damping += f"by {100 * check.damping:.3g} %"
    more = "more than the material " if zeta else ""
    rows = [f"damping      {damping}{_suggest_step(check, stepper, _damping, min(zeta, 1.0) + _HUNDREDTH, more)}"]
    if zeta >= 1:
        return rows
    lag = f"the mode lags by {check.phase_lag:.3g} degrees a period"
    advice = _suggest_step(check, stepper, _phase_lag, 360 * _HUNDREDTH, "of a period ")
    return [*rows, f"phase        {lag}{advice}"]


_Factor = Callable[[float, float], complex]


def _suggest_step(
    check: Check, stepper: str, measure: Callable[[_Factor, float, float], float], goal: float, unit: str
) -> str:
    """Return the step at which a measure of the lowest mode reaches its goal, "" if it is below."""
    factor, zeta = MODE_FACTORS[stepper], check.material_damping
    if measure(factor, check.z, zeta) <= goal:
        return ""
    z = brentq(lambda z: measure(factor, z, zeta) - goal, 1e-6, check.z)
    return f"; for {100 * _HUNDREDTH:g} % {unit}take dt near {z / check.omega_1:.2g} s"


def _damping(factor: _Factor, z: float, zeta: float) -> float:
    """Return the damping ratio of a mode that a step multiplies by factor(z, zeta)."""
    power = log(factor(z, zeta))
    return -power.real / abs(power)


def _phase_lag(factor: _Factor, z: float, zeta: float) -> float:
    """Return the phase [degree] by which a mode that a step multiplies by factor(z, zeta) lags after one period.

    A mode with more than critical damping has no period: NaN.
    """
    turn = z * find_mode_root(zeta).imag
    return 360 * (1 - phase(factor(z, zeta)) / turn) if turn else float("nan")
