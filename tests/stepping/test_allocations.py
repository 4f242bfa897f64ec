"""A step works in buffers allocated once: beside the state that it returns, it allocates nothing that grows."""

import ast
import tracemalloc
from pathlib import Path

import pytest

from pipeline import build, load_case

CELLS = [10, 30, 10]
MOTION = {"spin": {"axis": [0.0, 1.0, 0.0], "rate": 90.0, "center": [2.0, 12.0, 2.0]}}
SMALL = 22_000  # bytes: numbers, names and views, and the lanes of a kernel (14 kB), whatever the mesh
SMALL_OF_ORDER_TWO = 36_000  # its kernels also have the gradients of ten nodes and the matrix of a cell (23 kB)


@pytest.mark.parametrize("solver", ["banded", "warped", "multigrid", "pardiso", "cg"])
@pytest.mark.parametrize("stepper", ["backward_euler", "bdf2"])
@pytest.mark.parametrize(
    "method",
    [
        {"law": "linear"},
        {"iterations": 1},
        {"rotation": "gram_schmidt"},
        {"iterations": 2},
        {"iterations": "converged"},
        {"model": "auto"},
    ],
    ids=str,
)
def test_an_implicit_step_allocates_its_state(cases_folder, method: dict, stepper: str, solver: str) -> None:
    keys = {"mesh.cells": CELLS, "method.linear_solver": solver, "method.stepper": stepper}
    keys |= {f"method.{key}": value for key, value in method.items()}
    check_allocations(build(load_case(cases_folder / "bar_as_printed.toml", overrides=keys).variant("polar")))


@pytest.mark.parametrize("solver", ["warped", "multigrid"])
@pytest.mark.parametrize(
    "method",
    [
        {"law": "linear"},
        {"iterations": 1},
        {"iterations": 1, "rotation_at": "element"},
        {"iterations": 1, "volumetric": "mean"},
        {"iterations": "converged"},
        {"model": "auto"},
    ],
    ids=str,
)
def test_an_implicit_step_of_order_two_allocates_its_state(cases_folder, method: dict, solver: str) -> None:
    keys = {"mesh.cells": [8, 14, 8], "mesh.order": 2, "method.linear_solver": solver}
    keys |= {f"method.{key}": value for key, value in method.items()}
    problem = build(load_case(cases_folder / "bar_as_printed.toml", overrides=keys).variant("polar"))
    check_allocations(problem, small=SMALL_OF_ORDER_TWO)


@pytest.mark.parametrize("variant", ["linear", "polar", "gram_schmidt"])
def test_an_explicit_step_allocates_its_state(cases_folder, variant: str) -> None:
    keys = {"mesh.cells": CELLS, "schedule.dt": 1e-4, "method.stepper": "symplectic_euler", "method.mass": "lumped"}
    check_allocations(build(load_case(cases_folder / "bar_as_printed.toml", overrides=keys).variant(variant)))


@pytest.mark.parametrize("variant", ["linear", "polar"])
def test_a_step_with_supports_that_move_allocates_its_state(cases_folder, variant: str) -> None:
    keys = {"mesh.cells": CELLS, "supports": [{"plane": "y", "at": 12.0, "motion": MOTION}]}
    check_allocations(build(load_case(cases_folder / "bar_as_printed.toml", overrides=keys).variant(variant)), held=8)


@pytest.mark.parametrize(
    "method",
    [{}, {"law": "linear"}, {"stepper": "bdf2"}, {"iterations": "converged"}, {"model": "auto"}],
    ids=str,
)
def test_a_step_with_guides_and_damping_allocates_its_state(cases_folder, method: dict) -> None:
    """Besides some matrices (3, 3) of the guided nodes, 30 of 3751."""
    roller = {"box": [[0.0, 0.0, 0.0], [0.0, 12.0, 0.0]], "components": ["x"]}
    keys = {"mesh.cells": CELLS, "supports": [{"plane": "y", "at": 12.0}, roller]}
    keys |= {"material.stiffness_damping": 1e-3, "material.mass_damping": 0.1}
    keys |= {f"method.{key}": value for key, value in method.items()}
    problem = build(load_case(cases_folder / "bar_as_printed.toml", overrides=keys).variant("polar"))
    check_allocations(problem, guided=8)


KERNELS = sorted((Path(__file__).parents[2] / "pipeline").glob("*/kernels/*.py"))
# cells at once, nodes of a cell, sizes of its matrix, the dimension
CONSTANTS = {"LANES", "MOST_NODES", "NODES", "WIDTH", "_ENTRIES", "d", "np"}


@pytest.mark.parametrize("path", KERNELS, ids=lambda path: path.stem)
def test_kernels_allocate_nothing_that_grows(path: Path) -> None:
    """tracemalloc does not see allocations of numba."""
    found = find_allocations(path.read_text())
    assert [line for line, names in found if names - CONSTANTS] == []


def test_an_allocation_in_a_kernel_is_seen() -> None:
    source = "a = np.empty((9, LANES))\nb = np.zeros_like(x)\nc = x.copy(), np.empty(len(x))\n"
    assert [line for line, names in find_allocations(source) if names - CONSTANTS] == [2, 3, 3]


def find_allocations(source: str) -> list[tuple[int, set[str]]]:
    """The lines of calls that make arrays, and the names that their sizes depend on."""
    makers = {"empty", "zeros", "ones", "full", "empty_like", "zeros_like", "ones_like", "full_like", "copy", "array"}
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    made = [call for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr in makers]
    return sorted((c.lineno, {n.id for n in ast.walk(c) if isinstance(n, ast.Name)}) for c in made)


def check_allocations(problem, *, held: int = 0, guided: int = 0, small: int = SMALL) -> None:
    """Also allows `held` vectors of the held nodes, and `guided` matrices (3, 3) of each guided one."""
    room = small + held * problem.start.x[problem.body.supports.nodes].nbytes
    if guided:
        room += guided * 72 * len(problem.body.guide_cut.rows)
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
    assert new.x.nbytes > 4 * small and problem.body.mesh.integration.gradients.nbytes > 10 * new.x.nbytes
    assert kept < 2 * new.x.nbytes + room
    assert most < 2 * new.x.nbytes + room
