"""A step makes no matrix and nothing a cell: what it allocates is a few nodal vectors, and only the state stays."""

import tracemalloc

import pytest

from pipeline import build, load_case

VECTORS = 9  # of the size of x, at once, the state's own two among them


@pytest.mark.parametrize("solver", ["banded", "warped", "multigrid"])
@pytest.mark.parametrize("variant", ["linear", "polar"])
def test_what_a_step_allocates_is_a_few_nodal_vectors(cases_folder, variant: str, solver: str) -> None:
    keys = {"mesh.cells": [6, 18, 6], "method.linear_solver": solver}
    problem = build(load_case(cases_folder / "bar_as_printed.toml", overrides=keys).variant(variant))
    stepper = problem.prepare()
    state, _ = stepper.step(problem.start)
    state, _ = stepper.step(state)
    one = state.x.nbytes
    turned = 3 * one if solver != "banded" else 0  # the nodes' rotations, which replace those of the step before
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        new, _ = stepper.step(state)
        kept, most = (now - before for now in tracemalloc.get_traced_memory())
    finally:
        tracemalloc.stop()
    assert new.x.nbytes == one < problem.body.mesh.shape_gradients.nbytes / 10
    assert kept < 2 * one + turned + 20_000
    assert most < VECTORS * one + 2 * turned + 20_000
