"""The thesis' statements in words, tested on our runs; all thresholds that turn its wording into tests are here."""

from collections.abc import Callable, Mapping
from functools import cache

import numpy as np

from pipeline.case import MethodSpec
from pipeline.errors import SolveError
from pipeline.fem.body import Body
from pipeline.fem.mass import CONSISTENT_MASS
from pipeline.fem.material import Material
from pipeline.fem.supports import Supports
from pipeline.mesh.shapes import box
from pipeline.mesh.simplex import require_simplices
from pipeline.problem.methods import LAWS, ROTATIONS
from pipeline.problem.stage_solvers import make_stage_solver
from pipeline.series import read_series
from pipeline.stepping.backward_euler import BackwardEuler
from pipeline.stepping.state import State
from pipeline.studies.thesis.our_runs import RunOutcome, ThesisScene
from pipeline.studies.thesis.published import AS_PRINTED, THESIS_METHOD
from pipeline.studies.thesis.verdicts import NOT_REPRODUCED, OTHER_HARDWARE, REPRODUCED, find_outcome

Scenes = Mapping[str, ThesisScene]
ClaimResult = tuple[str, str]  # the result in words, and the verdict

SIMILAR = 0.10  # “very similar”: growths that differ by less than this fraction of the larger
INFINITESIMAL = 0.01  # “infinitesimal”: growth below this fraction of the linear one
SMALL = 0.10  # “small”: growth below this fraction of the linear one
FIRST = 10  # “the first iterations” of 100
ROUNDING = 1e-6  # “stable”: growth of the energy of a spin, which the linear law conserves exactly
STOPPED = 0.01  # “stops”: kinetic energy below this fraction of its maximum
FREE_END = 1.5  # “at the free end”: y of the last layer of cells [m]


def _compare_pairs(
    scenes: Scenes, needs: tuple[tuple[str, str], ...], holds: Callable[..., bool], text: Callable[..., str],
    reason: str,
) -> ClaimResult:  # fmt: skip
    """Return the results of (scene, variant) pairs as printed and with the factor, and whether the claim holds."""
    texts, verdicts = [], []
    for ending, how in ((AS_PRINTED, "as printed"), ("", "with factor")):
        outcomes = [find_outcome(scenes, scene + ending, variant) for scene, variant in needs]
        if all(outcome is not None for outcome in outcomes):
            texts.append(f"{how}: {text(*outcomes)}")
            verdicts.append((holds(*outcomes), how))
    if not verdicts:
        return "not run", f"{NOT_REPRODUCED}: not run"
    if (True, "as printed") in verdicts:
        return "; ".join(texts), REPRODUCED
    if (True, "with factor") in verdicts:
        return "; ".join(texts), f"{REPRODUCED} with factor {scenes[needs[0][0]].factor:g}"
    return "; ".join(texts), f"{NOT_REPRODUCED}: {reason}"


def _format_growths(*outcomes: RunOutcome) -> str:
    return "growth " + " and ".join(f"{run.largest_ratio - 1:.3g} ({run.folder.name})" for run in outcomes)


def _list_pair(scene: str) -> tuple[tuple[str, str], ...]:
    return (scene, "linear"), (scene, THESIS_METHOD)


def _make_smaller_test(part: float) -> Callable[[RunOutcome, RunOutcome], bool]:
    return lambda linear, other: other.largest_ratio - 1 < part * (linear.largest_ratio - 1)


def judge_small_bar(scenes: Scenes) -> ClaimResult:
    """Return whether the largest growths of f = 20 differ by less than 10 %."""
    is_smaller = _make_smaller_test(1 - SIMILAR)
    return _compare_pairs(scenes, _list_pair("bar_small"), lambda a, b: not is_smaller(a, b), _format_growths,
                          f"they differ by more than {SIMILAR:.0%}")  # fmt: skip


def judge_growth(scenes: Scenes) -> ClaimResult:
    """Return whether the linear bar grows more."""
    return _compare_pairs(scenes, _list_pair("bar"), _make_smaller_test(1.0), _format_growths, "it does not")


def judge_same_cell(scenes: Scenes) -> ClaimResult:
    """Return whether the largest growth of both methods is in the same cell."""
    return _compare_pairs(
        scenes, _list_pair("bar"), lambda a, b: a.cell == b.cell, lambda a, b: f"cells {a.cell} and {b.cell}",
        "different cells (the thesis does not say how it splits the bar)",
    )  # fmt: skip


def judge_free_end(scenes: Scenes) -> ClaimResult:
    """Return whether the cell that grows most lies in the last layer of cells at y = 0."""

    def find_top(linear: RunOutcome) -> float:
        mesh = require_simplices(read_series(linear.folder).mesh)
        return float(mesh.points[mesh.cells[linear.cell], 1].max())

    text = "the cell lies at y ≤ {:g} of 0…12 m"
    return _compare_pairs(scenes, (("bar", "linear"),), lambda a: find_top(a) <= FREE_END,
                   lambda a: text.format(find_top(a)), "the cell that grows most is not in the last layer")  # fmt: skip


def judge_first_iterations(scenes: Scenes) -> ClaimResult:
    """Return whether the largest growth falls in the first ten iterations."""
    return _compare_pairs(
        scenes, (("bar", "linear"),), lambda a: a.iteration <= FIRST, lambda a: f"iteration {a.iteration}",
        f"later than iteration {FIRST}",
    )  # fmt: skip


def judge_stop(scenes: Scenes) -> ClaimResult:
    """Return whether the bar's kinetic energy falls below 1 % of its maximum within the run."""
    text, verdict = _compare_pairs(
        scenes, (("bar_small", "linear"),), lambda a: a.kinetic_left < STOPPED,
        lambda a: f"{a.kinetic_left:.1e} of the kinetic energy is left", "it still moves",
    )  # fmt: skip
    return f"{text}. The integrator damps, see Damping: the material has no viscosity", verdict


def judge_mushroom(scenes: Scenes) -> ClaimResult:
    """Return whether the corotational growth is below 1 % of the linear one."""
    return _compare_pairs(scenes, _list_pair("mushroom"), _make_smaller_test(INFINITESIMAL), _format_growths,
                   f"smaller, but above {INFINITESIMAL:.0%} of the linear growth")  # fmt: skip


def judge_armadillo(scenes: Scenes) -> ClaimResult:
    """Return whether the corotational growth is below 10 % of the linear one."""
    return _compare_pairs(scenes, _list_pair("armadillo"), _make_smaller_test(SMALL), _format_growths,
                   f"above {SMALL:.0%} of the linear growth")  # fmt: skip


def judge_stability(scenes: Scenes) -> ClaimResult:
    """Return whether 100 steps of .5 s keep the energy of a free 2 x 24 x 4 m bar that spins at 10 rad/s."""
    worst = _find_worst_spins()
    growths = "; ".join(f"{name} × {energy:.2g} about {axis}" for name, (energy, axis) in worst.items())
    text = (
        f"kinetic energy of a free bar spun at 10 rad/s, Δt = 0.5 s, after 100 steps, about its worst axis: {growths}"
    )
    unstable = [name for name, (energy, _) in worst.items() if energy > 1 + ROUNDING]
    return text, f"{NOT_REPRODUCED}: not for {' and '.join(unstable)}" if unstable else REPRODUCED


@cache
def _find_worst_spins() -> dict[str, tuple[float, str]]:
    """Return, by method, the largest growth of kinetic energy over the three axes, and its axis."""
    methods = {
        "one polar solve a step": MethodSpec(),
        "linear": MethodSpec(law="linear"),
        "converged": MethodSpec(iterations="converged"),
    }
    axes = list(zip("xyz", np.eye(3), strict=True))
    return {
        name: max((measure_spin_energy_growth(direction, method), axis) for axis, direction in axes)
        for name, method in methods.items()
    }


def measure_spin_energy_growth(axis: np.ndarray, method: MethodSpec, steps: int = 100) -> float:
    """Return the kinetic energy after the steps over that at the start; infinity if a step fails."""
    mesh = box((2.0, 24.0, 4.0), (2, 8, 2))
    law = LAWS[method.law].part(Material(1e8, 0.33, 1000.0), ROTATIONS[method.rotation].part)
    body = Body(mesh, law, Supports(np.zeros(0, np.int64)), np.zeros_like(mesh.points), CONSISTENT_MASS)
    dt = 0.5
    # without the energy guard, which would end the motion
    stepper = BackwardEuler(body, dt, make_stage_solver(body, dt, method))
    v = 10.0 * np.cross(axis, mesh.points - mesh.points.mean(axis=0))
    state = State(0, mesh.points.copy(), v)
    try:
        for _ in range(steps):
            state, _ = stepper.step(state)
    except SolveError:  # a matrix that can no longer be factored
        return float("inf")
    end = float((state.v * body.momentum(state.v)).sum())
    return end / float((v * body.momentum(v)).sum())


def _judge_real_time(scenes: Scenes, variant: str, *, expected: bool) -> ClaimResult:
    factors = {}
    for scene in ("bar", "mushroom", "armadillo"):
        run = find_outcome(scenes, scene + AS_PRINTED, variant)
        if run is not None:
            factors[scene] = run.dt / run.seconds_per_step
    if not factors:
        return "not run", f"{NOT_REPRODUCED}: not run"
    text = ", ".join(f"{scene} {factor:.3g} × real time" for scene, factor in factors.items())
    holds = all((factor > 1) == expected for factor in factors.values())
    return text, REPRODUCED if holds else f"{OTHER_HARDWARE}: not on ours, with compiled sparse solvers"


def judge_linear_real_time(scenes: Scenes) -> ClaimResult:
    """Return whether every linear scene is solved faster than it moves."""
    return _judge_real_time(scenes, "linear", expected=True)


def judge_corotational_real_time(scenes: Scenes) -> ClaimResult:
    """Return whether every corotational scene is solved slower than it moves, as the thesis found."""
    return _judge_real_time(scenes, THESIS_METHOD, expected=False)


TESTS: Mapping[str, Callable[[Scenes], ClaimResult]] = {
    "small_bar_alike": judge_small_bar,
    "bar_grows_less": judge_growth,
    "same_cell": judge_same_cell,
    "free_end": judge_free_end,
    "first_iterations": judge_first_iterations,
    "bar_stops": judge_stop,
    "mushroom_infinitesimal": judge_mushroom,
    "armadillo_small": judge_armadillo,
    "unconditionally_stable": judge_stability,
    "linear_real_time": judge_linear_real_time,
    "corotational_real_time": judge_corotational_real_time,
}
