"""What the thesis says in words, put to the test on our runs; every threshold that a word is read as stands here."""

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
from pipeline.problem.methods import LAWS, ROTATIONS
from pipeline.problem.stage_solvers import make_stage_solver
from pipeline.series import read_series
from pipeline.stepping.backward_euler import BackwardEuler
from pipeline.stepping.state import State
from pipeline.studies.thesis.our_runs import RunOutcome, ThesisScene
from pipeline.studies.thesis.published import AS_PRINTED, THESIS_METHOD
from pipeline.studies.thesis.verdicts import NOT_REPRODUCED, OTHER_HARDWARE, REPRODUCED, find_outcome

Scenes = Mapping[str, ThesisScene]
Tested = tuple[str, str]  # what was found, and the verdict

SIMILAR = 0.10  # “very similar”: growths that differ by less than this part of the larger
INFINITESIMAL = 0.01  # “infinitesimal”: growth below this part of the linear one
SMALL = 0.10  # “small”: the same
FIRST = 10  # “the first iterations” of 100
ROUNDING = 1e-6  # of the energy of a spin that the linear law leaves exactly as it is
STOPPED = 0.01  # “stops”: kinetic energy below this part of its largest


def _compare_pairs(
    scenes: Scenes, needs: tuple[tuple[str, str], ...], holds: Callable[..., bool], text: Callable[..., str],
    reason: str,
) -> Tested:  # fmt: skip
    """Return what holds of the outcomes of (scene, variant) pairs, as printed and with the factor, else the reason."""
    findings, kept = [], []
    for ending, how in ((AS_PRINTED, "as printed"), ("", "with factor")):
        found = [find_outcome(scenes, scene + ending, variant) for scene, variant in needs]
        if all(one is not None for one in found):
            findings.append(f"{how}: {text(*found)}")
            kept.append((holds(*found), how))
    if not kept:
        return "not run", f"{NOT_REPRODUCED}: not run"
    if (True, "as printed") in kept:
        return "; ".join(findings), REPRODUCED
    if (True, "with factor") in kept:
        return "; ".join(findings), f"{REPRODUCED} with factor {scenes[needs[0][0]].factor:g}"
    return "; ".join(findings), f"{NOT_REPRODUCED}: {reason}"


def _format_growths(*outcomes: RunOutcome) -> str:
    return "growth " + " and ".join(f"{one.largest_ratio - 1:.3g} ({one.folder.name})" for one in outcomes)


def _list_pair(scene: str) -> tuple[tuple[str, str], ...]:
    return (scene, "linear"), (scene, THESIS_METHOD)


def _make_smaller_test(part: float) -> Callable[[RunOutcome, RunOutcome], bool]:
    return lambda linear, other: other.largest_ratio - 1 < part * (linear.largest_ratio - 1)


def small_bar_alike(scenes: Scenes) -> Tested:
    """Return whether the largest growths of f = 20 differ by less than 10 %."""
    is_smaller = _make_smaller_test(1 - SIMILAR)
    return _compare_pairs(scenes, _list_pair("bar_small"), lambda a, b: not is_smaller(a, b), _format_growths,
                          f"they differ by more than {SIMILAR:.0%}")  # fmt: skip


def bar_grows_less(scenes: Scenes) -> Tested:
    """Return whether the linear bar grows more."""
    return _compare_pairs(scenes, _list_pair("bar"), _make_smaller_test(1.0), _format_growths, "it does not")


def same_cell(scenes: Scenes) -> Tested:
    """Return whether the largest growth of both methods is in one cell."""
    return _compare_pairs(
        scenes, _list_pair("bar"), lambda a, b: a.cell == b.cell, lambda a, b: f"cells {a.cell} and {b.cell}",
        "other cells (the thesis does not say how it splits the bar)",
    )  # fmt: skip


def free_end(scenes: Scenes) -> Tested:
    """Return whether the cell that grows most lies in the last layer of cells at y = 0."""

    def farthest(linear: RunOutcome) -> float:
        mesh = read_series(linear.folder).mesh
        return float(mesh.points[mesh.cells[linear.cell], 1].max())

    text = "the cell lies at y ≤ {:g} of 0…12 m"
    # 1.5 m is one layer of cells
    return _compare_pairs(scenes, (("bar", "linear"),), lambda a: farthest(a) <= 1.5,
                   lambda a: text.format(farthest(a)), "the cell that grows most is not in the last layer")  # fmt: skip


def first_iterations(scenes: Scenes) -> Tested:
    """Return whether the largest growth falls in the first ten iterations."""
    return _compare_pairs(
        scenes, (("bar", "linear"),), lambda a: a.iteration <= FIRST, lambda a: f"iteration {a.iteration}",
        f"later than iteration {FIRST}",
    )  # fmt: skip


def bar_stops(scenes: Scenes) -> Tested:
    """Return whether the bar's kinetic energy falls below 1 % of its largest within the run."""
    found, verdict = _compare_pairs(
        scenes, (("bar_small", "linear"),), lambda a: a.kinetic_kept < STOPPED,
        lambda a: f"{a.kinetic_kept:.1e} of the kinetic energy is left", "it still moves",
    )  # fmt: skip
    return f"{found}. It is the integrator that damps, see Damping: the material has no viscosity", verdict


def mushroom_infinitesimal(scenes: Scenes) -> Tested:
    """Return whether the corotational growth is below 1 % of the linear one."""
    return _compare_pairs(scenes, _list_pair("mushroom"), _make_smaller_test(INFINITESIMAL), _format_growths,
                   f"smaller, but above {INFINITESIMAL:.0%} of the linear growth")  # fmt: skip


def armadillo_small(scenes: Scenes) -> Tested:
    """Return whether the corotational growth is below 10 % of the linear one."""
    return _compare_pairs(scenes, _list_pair("armadillo"), _make_smaller_test(SMALL), _format_growths,
                   f"above {SMALL:.0%} of the linear growth")  # fmt: skip


def unconditionally_stable(scenes: Scenes) -> Tested:
    """Return what 100 steps of .5 s make of a free 2 x 24 x 4 m bar in spin, 10 rad/s about x, y and z."""
    worst = _find_worst_spins()
    found = "; ".join(f"{name} × {energy:.2g} about {axis}" for name, (energy, axis) in worst.items())
    text = f"kinetic energy of a free bar spun at 10 rad/s, Δt = 0.5 s, after 100 steps, about its worst axis: {found}"
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
    """Return the kinetic energy after the steps over that at the start; infinity where a step fails."""
    mesh = box((2.0, 24.0, 4.0), (2, 8, 2))
    law = LAWS[method.law].part(Material(1e8, 0.33, 1000.0), ROTATIONS[method.rotation].part)
    body = Body(mesh, law, Supports(np.zeros(0, np.int64)), np.zeros_like(mesh.points), CONSISTENT_MASS)
    dt = 0.5
    # without the energy guard, which would stop it
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


def _judge_real_time(scenes: Scenes, variant: str, expected: bool) -> Tested:
    factors = {}
    for scene in ("bar", "mushroom", "armadillo"):
        run = find_outcome(scenes, scene + AS_PRINTED, variant)
        if run is not None:
            factors[scene] = run.dt / run.seconds_per_step
    if not factors:
        return "not run", f"{NOT_REPRODUCED}: not run"
    found = ", ".join(f"{scene} {factor:.3g} × real time" for scene, factor in factors.items())
    held = all((factor > 1) == expected for factor in factors.values())
    return found, REPRODUCED if held else f"{OTHER_HARDWARE}: not on ours, with compiled sparse solvers"


def linear_real_time(scenes: Scenes) -> Tested:
    """Return whether every linear scene is solved faster than it moves."""
    return _judge_real_time(scenes, "linear", True)


def corotational_real_time(scenes: Scenes) -> Tested:
    """Return whether every corotational scene is solved slower than it moves, as the thesis found."""
    return _judge_real_time(scenes, THESIS_METHOD, False)


TESTS: Mapping[str, Callable[[Scenes], Tested]] = {
    test.__name__: test
    for test in (
        small_bar_alike, bar_grows_less, same_cell, free_end, first_iterations, bar_stops, mushroom_infinitesimal,
        armadillo_small, unconditionally_stable, linear_real_time, corotational_real_time,
    )
}  # fmt: skip
