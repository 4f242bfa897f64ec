r"""Backward Euler's damping of the lowest modes of a linear body: by formula, and measured for each mode.

    z = omega dt,   zeta(z) = ln(1 + z^2) / sqrt(ln^2(1 + z^2) + 4 atan^2 z)

Measured: a few steps from the mode itself; its amplitudes q_n obey q_{n+2} = a q_{n+1} + b q_n, whose roots are the
factors G of one step, and zeta = -ln|G| / sqrt(ln^2|G| + arg^2 G).
"""

from dataclasses import dataclass, replace

import numpy as np

from pipeline.fem.modes import find_lowest_frequencies
from pipeline.problem.problem import Problem
from pipeline.problem.stage_solvers import make_stepper
from pipeline.stepping.backward_euler import damping_ratio
from pipeline.stepping.state import State


@dataclass(frozen=True)
class DampedMode:
    """A mode: frequency [rad/s], z = omega dt, damping ratio by formula and measured [1]."""

    omega: float
    z: float
    formula: float
    measured: float


def measure_damping(problem: Problem, count: int = 6) -> list[DampedMode]:
    """Return the lowest modes of a problem of the linear law, without its loads and initial state."""
    omegas, shapes = find_lowest_frequencies(problem.body, count)
    return [
        DampedMode(float(omega), z := float(omega) * problem.dt, damping_ratio(z), _measure_ratio(problem, shape))
        for omega, shape in zip(omegas, shapes, strict=True)
    ]


def _measure_ratio(problem: Problem, shape: np.ndarray) -> float:
    """Return the damping ratio of four steps from a displacement along a mode."""
    body = replace(problem.body, load=np.zeros_like(problem.body.load), varying_load=None)
    stepper = make_stepper(body, problem.dt, problem.method)
    X = body.mesh.points
    scale = 1e-3 * body.mesh.size / np.abs(shape).max()  # the body is linear: its response is proportional
    weighted = body.momentum(shape) / scale
    state = State(0, X + scale * shape, np.zeros_like(X))
    amplitudes = [1.0]
    for _ in range(4):
        state, _ = stepper.step(state)
        amplitudes.append(float((weighted * (state.x - X)).sum()))
    q = np.array(amplitudes)
    a, b = np.linalg.solve(np.stack([q[2:4], q[1:3]], axis=1), q[3:5])
    G = np.roots([1.0, -a, -b]).astype(complex)[0]
    decay, phase = np.log(np.abs(G)), np.angle(G)
    return float(-decay / np.hypot(decay, phase))
