"""Linear solvers on meshes of order 2: the same motion by all, and nearly as few iterations as with order 1."""

import numpy as np
import pytest

from pipeline.case import MethodSpec
from pipeline.fem.body import Body
from pipeline.linear import multigrid
from pipeline.linear.choice import estimate_factor_bytes
from pipeline.linear.multigrid import Cycle, make_rigid_modes
from pipeline.linear.pardiso import PardisoFactor
from pipeline.mesh.quadratic import find_side_ends, raise_order
from pipeline.mesh.shapes import box, rectangle
from pipeline.problem.methods import LINEAR_SOLVERS
from pipeline.problem.stage_solvers import make_stage_solver
from pipeline.run.frame_iterator import frames
from pipeline.stepping.stage import FrozenPasses
from tests.bodies import PLANAR, build_problem, case_document, list_states, make_solid

H = 0.07  # [s]: the waves pass the beam twice


def make_beam(cells: tuple[int, ...], order: int = 2, held: bool = True, **keywords: object) -> Body:
    """A beam of 4 x 12 (x 4) m, held at its end y = 12."""
    size = (4.0, 12.0, 4.0)[: len(cells)]
    mesh = box(size, cells) if len(cells) == 3 else rectangle(size, cells)
    mesh = raise_order(mesh) if order == 2 else mesh
    nodes = np.flatnonzero(mesh.points[:, 1] == 12.0) if held else ()
    return make_solid(mesh, "corotational", held=nodes, **keywords)  # type: ignore[arg-type]  # checked by the call


def bend(body: Body) -> np.ndarray:
    """Positions (n, d) of a beam whose free end is turned by half a radian."""
    x = body.mesh.points.copy()
    s = 1 - x[:, 1] / 12.0
    x[:, -1] += 6 * s * np.sin(0.5 * s) if x.shape[1] == 3 else 0.0
    x[:, 1] += x[:, 0] * np.sin(0.5 * s)
    return x


def solve_bent(body: Body, solver: str, **method: object) -> tuple[float, int]:
    """Return the relative residual of the solver's solution for the bent body, and its iterations."""
    passes = make_stage_solver(body, H, MethodSpec(linear_solver=solver, **method))  # type: ignore[arg-type]  # pydantic
    assert isinstance(passes, FrozenPasses)
    system, x = passes.system, bend(body)
    system.linearize(x, H)
    gravity = np.zeros_like(x)
    gravity[:, -1] = -9.81
    b = H * (body.momentum(gravity) + system.f)
    system.b[:] = b
    w = np.zeros_like(x)
    work = system.solve(w[body.supports.nodes], w)
    matrix = body.free_pattern.matrix(system.A[: body.free_pattern.blocks])
    free = b[body.free].ravel()
    return float(np.linalg.norm(matrix @ w[body.free].ravel() - free) / np.linalg.norm(free)), work.linear_iterations


@pytest.mark.parametrize("mass", ["consistent", "lumped"])
@pytest.mark.parametrize("cells", [(4, 10), (2, 4, 2)], ids=["triangles", "tetrahedra"])
@pytest.mark.parametrize("solver", LINEAR_SOLVERS)
def test_every_solver_solves_the_systems_of_order_two(solver: str, cells: tuple[int, ...], mass: str) -> None:
    residual, _ = solve_bent(make_beam(cells, mass=mass), solver)
    assert residual <= 1.01e-8


@pytest.mark.parametrize("stepper", ["backward_euler", "bdf2"])
@pytest.mark.parametrize("kind", [{"iterations": 1}, {"iterations": "converged"}, {"model": "auto"}, {"law": "linear"}])
def test_all_solvers_give_the_same_motion(kind: dict[str, object], stepper: str) -> None:
    law = {"law": "linear"} if "law" in kind else {}
    body = make_beam((1, 3, 1))
    if law:
        body = make_solid(body.mesh, "linear", held=body.supports.nodes)
    v = np.where(body.free_mask[:, None], [0.0, 0.0, -20.0], 0.0)
    ends = {
        name: list_states(body, 0.05, 6, v, linear_solver=name, stepper=stepper, **kind)[-1].x
        for name in LINEAR_SOLVERS
    }
    assert np.abs(ends["superlu"] - body.mesh.points).max() > 1.0
    for name, x in ends.items():
        assert np.abs(x - ends["superlu"]).max() <= 1e-5, name


@pytest.mark.parametrize("planar", [False, True], ids=["tetrahedra", "triangles"])
def test_all_solvers_give_the_same_damped_motion_on_rollers(tmp_path, planar: bool) -> None:
    sections = PLANAR if planar else {}
    document, ends = case_document(**sections), {}
    sections = {
        **sections,
        "mesh": {**document["mesh"], "order": 2},  # type: ignore[dict-item]  # a table
        "material": {**document["material"], "mass_damping": 0.5, "stiffness_damping": 1e-3},  # type: ignore[dict-item]
        "supports": [{"plane": "y", "at": 3.0, "components": ["y"]}, {"plane": "x", "at": 0.0, "components": ["x"]}],
        "initial": {"velocity": [0.0, 3.0] if planar else [0.0, 0.0, -5.0]},
    }
    for name in LINEAR_SOLVERS:
        problem = build_problem(tmp_path, **sections, method={"linear_solver": name})
        *_, last = frames(problem)
        ends[name] = last.x
    assert np.abs(ends["superlu"] - problem.body.mesh.points).max() > 0.001
    for name, x in ends.items():
        assert np.abs(x - ends["superlu"]).max() <= 1e-8, name


# of the bent beam, to 1e-6: measured with 8 x 24 x 8 cells of order 1 and 4 x 12 x 4 of order 2, as many nodes
ITERATIONS = {"warped": (8, 8), "multigrid": (12, 15), "cg": (345, 415)}


@pytest.mark.parametrize("solver", ITERATIONS)
def test_iterations_are_nearly_those_of_linear_tetrahedra_with_as_many_nodes(solver: str) -> None:
    one, two = (
        solve_bent(make_beam(cells, order), solver, linear_rtol=1e-6)[1]
        for cells, order in (((8, 24, 8), 1), ((4, 12, 4), 2))
    )
    expected = ITERATIONS[solver]
    assert abs(one - expected[0]) <= 1 + 0.05 * expected[0] and abs(two - expected[1]) <= 1 + 0.05 * expected[1]
    assert two <= 1.35 * one


def test_the_estimate_of_a_sparse_factor_is_that_of_mkl() -> None:
    body = make_beam((4, 12, 4))
    A = np.empty_like(body.mass)
    body.assemble_system(body.mesh.points, H, np.empty_like(body.mesh.points), A)
    factor = PardisoFactor(body.free_pattern, np.float64)
    factor._options[17] = -1  # report the entries of the factor
    factor.update(A[: body.free_pattern.blocks])
    assert 8 * factor._options[17] == pytest.approx(estimate_factor_bytes(body.free_pattern, "pardiso"), rel=0.3)


# The cycle of order 2


def make_cycle(body: Body) -> tuple[Cycle, np.ndarray]:
    """Return the cycle of M + h^2 K at rest, whose first coarse space is that of the corners, and the dense matrix."""
    A = np.empty_like(body.mass)
    body.assemble_system(body.mesh.points, H, np.empty_like(body.mesh.points), A)
    matrix = body.free_pattern.matrix(A[: body.free_pattern.blocks])
    ends = number_free(body)[find_side_ends(body.mesh)[body.free]]
    return Cycle(matrix, make_rigid_modes(body.mesh.points[body.free]), ends=ends), matrix.toarray()


def number_free(body: Body) -> np.ndarray:
    number = np.full(len(body.mesh.points), -1)
    number[body.free] = np.arange(len(body.free))
    return number


@pytest.mark.parametrize("cells", [(4, 10), (2, 5, 2)], ids=["triangles", "tetrahedra"])
def test_a_cycle_on_corners_is_symmetric_and_near_the_inverse(monkeypatch, cells: tuple[int, ...]) -> None:
    monkeypatch.setattr(multigrid, "_LAST_BAND", 0.01)
    body = make_beam(cells)
    cycle, dense = make_cycle(body)
    assert isinstance(cycle._solve_below, Cycle)
    corners = body.mesh.cells[:, : len(cells) + 1]
    assert len(cycle._coarse) == len(np.setdiff1d(corners, body.supports.nodes))
    scale, shape = 1 / np.abs(dense).max(), (len(body.free), len(cells))
    unit = np.eye(len(dense), dtype=np.float32)
    C = np.stack([cycle(scale * column.reshape(shape)).ravel().astype(float) for column in unit]) / scale
    np.testing.assert_allclose(C, C.T, atol=1e-4 * np.abs(C).max())
    root = np.linalg.cholesky(dense)
    values = np.linalg.eigvalsh(root.T @ (C + C.T) @ root / 2)
    assert values.min() > 0.1 and values.max() < 1.01


def test_ends_are_the_corners_of_sides_and_each_corner_is_its_own() -> None:
    mesh = raise_order(box((1.0, 2.0, 1.0), (2, 3, 2)))
    ends = find_side_ends(mesh)
    np.testing.assert_allclose(mesh.points[ends].mean(axis=1), mesh.points, atol=1e-15)
    corners = np.unique(mesh.cells[:, :4])
    assert (ends[corners] == corners[:, None]).all()
    others = np.setdiff1d(np.arange(len(mesh.points)), corners)
    assert (ends[others, 0] != ends[others, 1]).all() and np.isin(ends, corners).all()


@pytest.mark.parametrize("free", ["a corner", "sides", "all"])
def test_multigrid_takes_bodies_with_few_free_nodes(free: str) -> None:
    mesh = raise_order(box((1.0, 1.0, 1.0), (1, 1, 1)))
    corners = np.unique(mesh.cells[:, :4])
    held = {"a corner": np.arange(1, len(mesh.points)), "sides": corners, "all": ()}[free]
    body = make_solid(mesh, "corotational", held=held)
    v = np.where(body.free_mask[:, None], [0.0, 3.0, -2.0], 0.0)
    ends = [list_states(body, 0.02, 3, v, linear_solver=name)[-1].x for name in ("superlu", "multigrid")]
    np.testing.assert_allclose(*ends, atol=1e-6)
