"""All linear solvers give the same motion, and report matrices that they cannot solve."""

import sys

import numpy as np
import pytest

from pipeline import build, frames, load_case
from pipeline.errors import SolveError
from pipeline.fem.assembly import assemble_pattern
from pipeline.linear import choice as linear_solve
from pipeline.linear import pardiso
from pipeline.linear import rest_preconditioner as warped
from pipeline.linear.band import Band
from pipeline.linear.banded import BandedCholesky
from pipeline.linear.kernels.vectors import invert_blocks
from pipeline.linear.pardiso import Pardiso
from pipeline.linear.rest_preconditioner import make_multigrid_cg, make_warped_cg
from pipeline.linear.solver import RestState, SystemSettings
from pipeline.mesh.shapes import box
from pipeline.problem import problem as problem_module
from pipeline.problem import stage_solvers
from pipeline.problem.methods import LINEAR_SOLVERS
from pipeline.problem.stage_solvers import list_linear_solvers
from pipeline.stepping.symplectic_euler import true_limit

NO_REST = RestState(np.zeros((0, 3)), lambda: np.zeros((0, 3, 3)))  # direct solvers do not use it


def write_identities(rotations: np.ndarray) -> None:
    np.copyto(rotations, np.eye(3))


def run_bar(cases_folder, solver: str, variant: str, **keys: object) -> list[np.ndarray]:
    overrides = {"method.linear_solver": solver, "schedule.frames": 100, **keys}
    return [
        frame.x for frame in frames(build(load_case(cases_folder / "bar.toml", overrides=overrides).variant(variant)))
    ]


@pytest.mark.parametrize("variant", ["linear", "gram_schmidt", "polar", "converged"])
def test_all_solvers_give_the_same_trajectory(cases_folder, variant: str) -> None:
    runs = {name: run_bar(cases_folder, name, variant) for name in LINEAR_SOLVERS}
    size = np.linalg.norm([4.0, 12.0, 4.0])
    for name, run in runs.items():
        apart = max(np.abs(a - b).max() for a, b in zip(run, runs["superlu"], strict=True))
        assert apart <= 1e-6 * size, name


FACTORS = ["banded", "mkl", "cholmod", "superlu"]


def allow_only(monkeypatch, factor: str) -> None:
    """Make this factor of the rest state the only one available."""
    if factor != "banded":
        monkeypatch.setattr(warped, "_SMALL_BAND", 0.0)
        monkeypatch.setattr(warped, "_LARGE_BAND", 0.0)
    if factor in ("cholmod", "superlu"):
        monkeypatch.setattr(pardiso, "load_mkl", lambda: None)
    if factor == "superlu":
        monkeypatch.setitem(sys.modules, "cholespy", None)  # as if it were not installed


@pytest.mark.parametrize("factor", FACTORS)
def test_warped_takes_one_factor_for_the_whole_run(cases_folder, monkeypatch, factor: str) -> None:
    allow_only(monkeypatch, factor)
    overrides = {"method.linear_solver": "warped", "schedule.frames": 10}
    run = frames(build(load_case(cases_folder / "bar.toml", overrides=overrides).variant("polar")))
    work = [frame.work for frame in run]
    assert [step.factorizations for step in work] == [0, 1, *[0] * 9]
    assert all(1 < step.linear_iterations < 60 for step in work[1:])


@pytest.mark.parametrize("solver", ["warped", "multigrid"])
@pytest.mark.parametrize(("keys", "most"), [({"method.iterations": "converged"}, 1), ({"method.model": "auto"}, 2)])
def test_newton_and_auto_keep_this_factor_too(cases_folder, solver: str, keys: dict[str, object], most: int) -> None:
    overrides = {"method.linear_solver": solver, "schedule.frames": 10, **keys}
    work = [f.work for f in frames(build(load_case(cases_folder / "bar.toml", overrides=overrides).variant("polar")))]
    assert sum(step.solves for step in work) > 10  # several in some steps
    assert 1 <= sum(step.factorizations for step in work) <= most  # auto's linear rung has its own


@pytest.mark.parametrize("factor", FACTORS)
def test_warped_gives_the_same_with_every_factor(cases_folder, monkeypatch, factor: str) -> None:
    expected = run_bar(cases_folder, "superlu", "polar", **{"schedule.frames": 20})
    allow_only(monkeypatch, factor)
    run = run_bar(cases_folder, "warped", "polar", **{"schedule.frames": 20})
    assert np.abs(run[-1] - expected[-1]).max() < 1e-5
    pattern = assemble_pattern(box([1.0, 1.0, 1.0], [1, 1, 1])).pattern
    unit = np.where((pattern.rows == pattern.indices)[:, None, None], np.eye(3), 0.0)
    assert warped.factor_rest(SystemSettings(pattern, 1e-8, RestState(np.zeros((8, 3)), lambda: unit))).name == factor


def test_the_choice_depends_on_size_stiffness_memory_and_installed_libraries(monkeypatch) -> None:
    small = assemble_pattern(box([1.0, 1.0, 1.0], [1, 1, 1])).pattern
    large = assemble_pattern(box([1.0, 1.0, 1.0], [9, 9, 9])).pattern

    reasons: list[str] = []

    def choose(pattern, *, constant: bool, stiffness: float = 1e3, order: int = 1) -> str:
        name, reason = linear_solve.choose_solver(Band(pattern), constant=constant, stiffness=stiffness, order=order)
        assert "MB" in reason
        reasons.append(reason)
        return name

    assert choose(small, constant=True) == choose(small, constant=False) == "banded"
    assert choose(large, constant=False) == choose(large, constant=False, stiffness=2.0) == "warped"
    monkeypatch.setattr(linear_solve, "_WARPED_BAND", 1.0)
    assert choose(large, constant=False) == "multigrid" and choose(large, constant=False, stiffness=2.0) == "cg"
    assert "more than 0.5, with warped 1; h omega_max is up to 1e+03" in reasons[-2]
    assert choose(large, constant=False, stiffness=15.0) == "multigrid"
    assert choose(large, constant=False, stiffness=15.0, order=2) == "cg"
    monkeypatch.setattr(linear_solve, "_CONSTANT_BAND", 1.0)
    assert choose(large, constant=True) == "pardiso"
    with monkeypatch.context() as small_machine:
        small_machine.setattr(linear_solve, "read_installed_bytes", lambda: 1e6)
        assert choose(large, constant=True) == "multigrid"
        assert " GB, more than half of the memory, 0.0005; " in reasons[-1]
    with monkeypatch.context() as few_steps:
        few_steps.setattr(linear_solve, "_PAID_FACTOR", 1e5)
        assert choose(large, constant=True) == "multigrid"
        assert " GB, more than 0.0001; " in reasons[-1]
    monkeypatch.setattr(linear_solve, "load_mkl", lambda: None)
    monkeypatch.setattr(linear_solve, "_CONSTANT_BAND_WITHOUT_MKL", 1.0)
    assert choose(large, constant=True) == "superlu"
    monkeypatch.setattr(linear_solve, "_LU_BAND", 1.0)
    assert choose(large, constant=True) == "multigrid"
    assert "with superlu 1; MKL is not installed" in reasons[-1]


def test_the_frequency_bound_is_an_upper_bound(cases_folder) -> None:
    body = build(load_case(cases_folder / "bar.toml").variant("polar")).body
    highest = 2 / true_limit(body)
    assert highest <= body.frequency_bound < 4 * highest


def test_pardiso_without_mkl_is_superlu_with_a_note(cases_folder, monkeypatch) -> None:
    expected = run_bar(cases_folder, "superlu", "polar", **{"schedule.frames": 3})
    for module in (pardiso, linear_solve, stage_solvers, problem_module):
        monkeypatch.setattr(module, "load_mkl", lambda: None)
    run = run_bar(cases_folder, "pardiso", "polar", **{"schedule.frames": 3})
    assert np.array_equal(run[-1], expected[-1])
    case = load_case(cases_folder / "bar.toml", overrides={"method.linear_solver": "pardiso"})
    problem = build(case.variant("polar"))
    assert "superlu replaces it; to install it: pip install 'corotational-pipeline[mkl]'" in problem.notes[-1]
    solvers = list_linear_solvers(problem.body, problem.dt, problem.method)
    assert solvers == [{"name": "superlu", "reason": "the case names pardiso; MKL is not installed"}]
    with pytest.raises(SolveError, match=r"pip install 'corotational-pipeline\[mkl\]'"):
        Pardiso(SystemSettings(problem.body.free_pattern, 1e-8, NO_REST))


@pytest.mark.parametrize("solver", [BandedCholesky, make_warped_cg, make_multigrid_cg, Pardiso])
def test_an_indefinite_matrix_is_an_error(solver) -> None:
    mesh = box([1.0, 1.0, 1.0], [1, 1, 1])
    pattern = assemble_pattern(mesh).pattern
    good = np.where((pattern.rows == pattern.indices)[:, None, None], np.eye(3), 0.0)
    bad = good.copy()
    bad[0] = np.diag([1.0, 1.0, -1.0])
    prepared = solver(SystemSettings(pattern, 1e-8, RestState(mesh.points, lambda: good)))
    b = np.zeros((8, 3))
    b[0, 2] = 1.0
    with pytest.raises(SolveError, match="not positive definite"):
        prepared.update(bad, write_identities)
        prepared.solve(b, 0 * b)


@pytest.mark.parametrize("d", [2, 3])
def test_blocks_are_inverted(d: int) -> None:
    A = np.random.default_rng(3).normal(size=(9, d, d))
    D = np.empty((4, d, d))
    assert invert_blocks(A, np.array([1, 8, 0, 3]), D)
    np.testing.assert_allclose(D, np.linalg.inv(A[[1, 8, 0, 3]]), rtol=1e-10)
    A[8] = 0.0
    assert not invert_blocks(A, np.array([1, 8, 0, 3]), D)


def test_a_band_holds_every_entry_once() -> None:
    pattern = assemble_pattern(box([1.0, 2.0, 1.0], [2, 3, 2])).pattern
    rng = np.random.default_rng(0)
    values = rng.normal(size=(pattern.blocks, 3, 3))
    values[pattern.diagonal] += np.swapaxes(values[pattern.diagonal], 1, 2) + 100 * np.eye(3)
    full = pattern.matrix(values).toarray()
    np.testing.assert_array_equal(full, full.T)
    solver = BandedCholesky(SystemSettings(pattern, 1e-8, NO_REST))
    solver.update(values, write_identities)
    b = rng.normal(size=(pattern.nodes, 3))
    x = np.empty_like(b)
    solver.solve(b, x)
    np.testing.assert_allclose(full @ x.ravel(), b.ravel(), atol=1e-12)
    assert Band(pattern).width < len(full)


@pytest.mark.parametrize(
    ("variant", "keys", "names"),
    [
        ("linear", {}, ["banded"]),
        ("polar", {}, ["banded"]),
        ("polar", {"mesh.cells": [6, 12, 6]}, ["warped"]),
        ("polar", {"method.model": "auto", "mesh.cells": [6, 12, 6]}, ["banded", "warped"]),
        ("polar", {"method.linear_solver": "cg"}, ["cg"]),
        ("polar", {"method.linear_solver": "warped"}, ["warped"]),
    ],
)
def test_a_run_names_its_solvers_with_reasons(cases_folder, variant: str, keys: dict, names: list[str]) -> None:
    problem = build(load_case(cases_folder / "bar.toml", overrides=keys).variant(variant))
    solvers = list_linear_solvers(problem.body, problem.dt, problem.method)
    assert [solver["name"] for solver in solvers] == names
    for solver in solvers:
        reasons = {"cg": "the case names it", "warped": "the case names it; the factor at rest is banded"}
        assert solver["reason"] == reasons[names[0]] if "method.linear_solver" in keys else " MB, " in solver["reason"]


@pytest.mark.parametrize("factor", ["banded", "mkl", "multigrid"])
@pytest.mark.parametrize("dt", [1.0, 10.0, 100.0])
def test_the_loss_of_single_precision_does_not_fail_a_run(tmp_path, monkeypatch, factor: str, dt: float) -> None:
    """A free, stiff body in long steps: only its mass makes the matrix definite, and single precision loses it."""
    case = tmp_path / "free.toml"
    case.write_text(
        'name = "free"\nmesh = {shape = "box", size = [1.0, 1.0, 1.0], cells = [4, 4, 4]}\n'
        "material = {youngs_modulus = 1e8, poisson_ratio = 0.3, density = 1000.0}\n"
        "initial = {velocity = [1.0, 0.0, 0.0]}\n"
        f"schedule = {{dt = {dt}, frames = 2}}\n"
    )

    def find_end(solver: str) -> np.ndarray:
        *_, last = frames(build(load_case(case, overrides={"method.linear_solver": solver})))
        return last.x

    expected = find_end("banded")
    if factor != "multigrid":
        allow_only(monkeypatch, factor)
    x = find_end("multigrid" if factor == "multigrid" else "warped")
    assert np.abs(x - expected).max() < 1e-5 * 2 * dt  # of the distance moved; ill-conditioned
