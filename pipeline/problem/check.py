"""What can be known of a problem before it is solved."""

from cmath import log, phase
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from pipeline.errors import SolveError
from pipeline.fem.modes import lowest_frequencies
from pipeline.mesh.simplex import component_labels, quality
from pipeline.problem.methods import MODE_FACTORS
from pipeline.problem.problem import Problem
from pipeline.stepping.symplectic_euler import element_limit, true_limit

# eigenvalues of larger bodies take longer than many a run
_MODE_LIMIT = 200_000
_HUNDREDTH = 0.01  # of damping, of a period: what a remedy is told for


@dataclass(frozen=True)
class Check:
    """Counts, volumes [m3], quality (1 is regular), speed of pressure waves [m/s], lowest frequency [rad/s], z = omega
    dt, the damping ratio and phase lag [degrees a period] that the stepper gives that mode (NaN for symplectic Euler),
    and the steps [s] below which symplectic Euler is stable: by a bound over the cells, and the limit itself.
    """

    dimension: int
    nodes: int
    cells: int
    held: int
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
    damping: float
    phase_lag: float
    explicit_bound: float
    explicit_limit: float


def check_problem(problem: Problem) -> Check:
    """Return the numbers of a problem; omega_1 is NaN where the body is too large to look for it, or rigid."""
    body = problem.body
    mesh = body.mesh
    q = quality(mesh)
    omega = _lowest(problem)
    z = omega * problem.dt
    factor = MODE_FACTORS.get(problem.method.stepper, lambda z: complex("nan"))
    return Check(
        dimension=mesh.dimension,
        nodes=len(mesh.points),
        cells=len(mesh.cells),
        held=len(body.supports.nodes),
        components=component_labels(mesh)[0],
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
        damping=_damping(factor, z),
        phase_lag=_phase_lag(factor, z),
        explicit_bound=element_limit(body),
        explicit_limit=_limit(problem),
    )


def _lowest(problem: Problem) -> float:
    if len(problem.body.mesh.cells) > _MODE_LIMIT:
        return float("nan")
    try:
        found, _ = lowest_frequencies(problem.body)
    except SolveError:
        return float("nan")
    return float(found[0]) if len(found) else float("nan")


def _limit(problem: Problem) -> float:
    if len(problem.body.mesh.cells) > _MODE_LIMIT:
        return float("nan")
    return true_limit(problem.body)


def format_check(found: Check, problem: Problem) -> list[str]:
    """Return the check as lines to read."""
    kind, unit = ("tetrahedra", "m3") if found.dimension == 3 else ("triangles", "m2")
    rows = [
        f"nodes        {found.nodes}, of which {found.held} are held",
        f"{kind:<12} {found.cells} in {found.components} component{'s' * (found.components > 1)}",
        f"volume       {found.total_volume:.6g} {unit}; "
        f"cells from {found.smallest_volume:.4g} to {found.largest_volume:.4g}",
        f"quality      worst {found.worst_quality:.3f} (cell {found.worst_cell}), "
        f"median {found.median_quality:.3f}; 1 is regular",
        f"mass         {found.mass:.6g} kg; pressure waves run at {found.wave_speed:.4g} m/s",
    ]
    if np.isfinite(found.omega_1):
        rows += [
            f"omega_1      {found.omega_1:.4g} rad/s, the lowest elastic one ({found.omega_1 / 2 / np.pi:.4g} Hz)",
            f"omega_1 dt   {found.z:.4g} with dt = {problem.dt:g} s",
        ]
        rows += _mode_lines(found, problem.method.stepper)
    rows.append(
        f"explicit     symplectic Euler is stable below {found.explicit_limit:.4g} s; "
        f"the bound over the cells is {found.explicit_bound:.4g} s"
    )
    rows += [f"note         {note}" for note in problem.notes]
    return rows


def _mode_lines(found: Check, stepper: str) -> list[str]:
    """Return what a stepper does to the lowest mode, and the steps that would bring it to a hundredth."""
    if stepper not in MODE_FACTORS:
        return []
    factor = MODE_FACTORS[stepper]

    def remedy(measure: Callable[[Callable[[float], complex], float], float], wanted: float, unit: str) -> str:
        if measure(factor, found.z) <= wanted:
            return ""
        z = brentq(lambda z: measure(factor, z) - wanted, 1e-6, found.z)
        return f"; for {100 * _HUNDREDTH:g} % {unit}take dt near {z / found.omega_1:.2g} s"

    return [
        f"damping      {stepper} damps that mode by {100 * found.damping:.3g} % of critical"
        + remedy(_damping, _HUNDREDTH, ""),
        f"phase        it lags by {found.phase_lag:.3g} degrees a period"
        + remedy(_phase_lag, 360 * _HUNDREDTH, "of a period "),
    ]


def _damping(factor: Callable[[float], complex], z: float) -> float:
    """Return the damping ratio of a mode that a step multiplies by that factor."""
    power = log(factor(z))
    return -power.real / abs(power)


def _phase_lag(factor: Callable[[float], complex], z: float) -> float:
    """Return by how much such a mode has turned too little after one of its periods [degree]."""
    return 360 * (1 - phase(factor(z)) / z)
