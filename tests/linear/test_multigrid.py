"""Multigrid: groups and coarse motions have their properties; a cycle is nearly as good as a factor on any body."""

import numpy as np
import pytest
from scipy.sparse import bsr_array, csr_array
from scipy.sparse.csgraph import connected_components

from pipeline import build, frames, load_case
from pipeline.errors import SolveError
from pipeline.linear import multigrid
from pipeline.linear.multigrid import Cycle, make_rigid_modes
from pipeline.mesh.simplex import Mesh


def at_rest(cases_folder, h: float = 0.07, **keys: object) -> tuple[bsr_array, np.ndarray]:
    """M + h^2 K of the bar's free nodes, and their positions."""
    body = build(load_case(cases_folder / "bar_as_printed.toml", overrides=keys).variant("polar")).body
    A = np.empty_like(body.mass)
    body.assemble_system(body.mesh.points, h, np.empty_like(body.mesh.points), A)
    return body.free_pattern.matrix(A[: body.free_pattern.blocks]), body.mesh.points[body.free]


def levels(cycle: object) -> int:
    return 1 + levels(cycle._solve_below) if isinstance(cycle, Cycle) else 1


@pytest.mark.parametrize(("band", "count"), [(40.0, 2), (0.002, 3)])
def test_a_cycle_is_symmetric_and_near_the_inverse(cases_folder, monkeypatch, band: float, count: int) -> None:
    monkeypatch.setattr(multigrid, "_LAST_BAND", band)
    A, X = at_rest(cases_folder, **{"mesh.cells": [4, 12, 4]})
    cycle = Cycle(A, make_rigid_modes(X))
    assert levels(cycle) == count
    dense = A.toarray()
    scale = 1 / np.abs(dense).max()
    unit = np.eye(len(dense), dtype=np.float32)
    C = scale * np.stack([cycle(scale * column.reshape(X.shape)).ravel().astype(float) for column in unit]) / scale**2
    np.testing.assert_allclose(C, C.T, atol=1e-4 * np.abs(C).max())
    root = np.linalg.cholesky(dense)
    values = np.linalg.eigvalsh(root.T @ (C + C.T) @ root / 2)
    # Gauss-Seidel about an exact correction never overshoots; single precision may by a little
    assert values.max() < 1.01
    assert values.min() > (0.2 if count == 2 else 0.1)


def test_groups_are_neighborhoods_and_take_every_node() -> None:
    rng = np.random.default_rng(0)
    near = rng.random((60, 60)) < 0.05
    near[7] = near[:, 7] = False
    graph = csr_array(near | near.T | np.eye(60, dtype=bool))
    group = multigrid._group_nodes(graph)
    assert set(group) == set(range(group.max() + 1))
    assert (group == group[7]).sum() == 1  # no node's neighbor
    for number in range(group.max() + 1):
        members = np.flatnonzero(group == number)
        inside = graph[members][:, members].toarray()
        centers = np.flatnonzero(inside.sum(axis=1) == np.diff(graph.indptr)[members])
        assert len(centers)  # nodes whose neighbors all belong to the group
        assert connected_components(inside)[0] == 1


def test_coarse_motions_hold_the_rigid_ones(cases_folder) -> None:
    body = build(load_case(cases_folder / "bar.toml").variant("polar")).body
    _, K = body.linearize(body.mesh.points)
    stiffness = body.pattern.matrix(K)
    modes = make_rigid_modes(body.mesh.points)
    flat = modes.reshape(-1, 6)
    assert np.linalg.matrix_rank(flat) == 6
    assert np.abs(stiffness @ flat).max() < 1e-12 * np.abs(K).max()
    inverses = np.linalg.inv(stiffness.toarray().reshape(len(modes), 3, -1, 3).diagonal(axis1=0, axis2=2).T)
    group = multigrid._group_nodes(csr_array((np.ones(len(stiffness.indices)), stiffness.indices, stiffness.indptr)))
    P, coarse = multigrid._make_prolongation(stiffness, inverses, modes, group)
    np.testing.assert_allclose(P @ coarse.reshape(-1, 6), flat, atol=1e-10)


@pytest.mark.parametrize("h", [1e-3, 0.07, 10.0])
def test_iterations_stay_few_whatever_the_step(cases_folder, h: float) -> None:
    keys = {"mesh.cells": [8, 26, 8], "method.linear_solver": "multigrid", "schedule.dt": h, "schedule.frames": 2}
    run = frames(build(load_case(cases_folder / "bar_as_printed.toml", overrides=keys).variant("polar")))
    work = [frame.work for frame in run]
    assert [step.factorizations for step in work] == [0, 1, 0]
    assert all(0 < step.linear_iterations < 40 for step in work[1:])


@pytest.mark.parametrize("mesh", ["plane", "one free node", "two bodies"])
def test_any_body_gets_the_motion_of_the_direct_solver(cases_folder, mesh: str) -> None:
    corner = np.array([[0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 0.0]])
    given = {
        "plane": None,
        "one free node": Mesh(corner, np.array([[0, 1, 2, 3]])),
        "two bodies": Mesh(
            np.concatenate([corner, corner + np.array([3.0, 0.5, 0.0])]), np.array([[0, 1, 2, 3], [4, 5, 6, 7]])
        ),
    }[mesh]
    case, variant = ("swing2d", "backward_euler") if given is None else ("bar", "polar")
    ends = {}
    for solver in ("superlu", "multigrid"):
        keys = {"method.linear_solver": solver, "schedule.frames": 1, "schedule.steps_per_frame": 5}
        if given is not None:
            keys["supports"] = [{"plane": "y", "at": 1.0}]
        run = load_case(cases_folder / f"{case}.toml", overrides=keys).variant(variant)
        *_, last = frames(build(run, mesh=given))
        ends[solver] = last.x
    np.testing.assert_allclose(ends["multigrid"], ends["superlu"], atol=1e-6)


def test_a_singular_diagonal_block_is_an_error(cases_folder) -> None:
    A, X = at_rest(cases_folder)
    A.data[:] = 1.0
    with pytest.raises(SolveError, match="diagonal block"):
        Cycle(A, make_rigid_modes(X))
