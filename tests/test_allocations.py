"""A step works in room made once: beyond the state that it returns it allocates nothing that grows with the mesh."""

import tracemalloc

import pytest

from pipeline import build, load_case

CELLS = [10, 24, 10]
SMALL = 16_000  # bytes: numbers, names and views, whatever the mesh


@pytest.mark.parametrize("solver", ["banded", "warped", "multigrid", "pardiso", "cg"])
@pytest.mark.parametrize("stepper", ["backward_euler", "bdf2"])
@pytest.mark.parametrize(
    "method",
    [{"law": "linear"}, {"iterations": 1}, {"iterations": 2}, {"iterations": "converged"}, {"model": "auto"}],
    ids=str,
)
def test_an_implicit_step_allocates_its_state(cases_folder, method: dict, stepper: str, solver: str) -> None:
    keys = {"mesh.cells": CELLS, "method.linear_solver": solver, "method.stepper": stepper}
    keys |= {f"method.{key}": value for key, value in method.items()}
    check(build(load_case(cases_folder / "bar_as_printed.toml", overrides=keys).variant("polar")))


def test_an_explicit_step_allocates_its_state(cases_folder) -> None:
    keys = {"mesh.cells": CELLS, "schedule.dt": 1e-4, "method.stepper": "symplectic_euler", "method.mass": "lumped"}
    check(build(load_case(cases_folder / "bar_as_printed.toml", overrides=keys).variant("polar")))


def check(problem) -> None:
    stepper = problem.prepare()
    state = problem.start
    for _ in range(3):
        state, _ = stepper.step(state)
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        new, _ = stepper.step(state)
        kept, most = (now - before for now in tracemalloc.get_traced_memory())
    finally:
        tracemalloc.stop()
    assert new.x.nbytes > 4 * SMALL and problem.body.mesh.shape_gradients.nbytes > 10 * new.x.nbytes
    assert kept < 2 * new.x.nbytes + SMALL
    assert most < 2 * new.x.nbytes + SMALL
