"""Every linear solver gives the same motion, and says so where a matrix is none that it can take."""

import numpy as np
import pytest

from pipeline import build, frames, load_case
from pipeline.errors import SolveError
from pipeline.mesh.shapes import box
from pipeline.methods import LINEAR_SOLVERS
from pipeline.stepping.banded import Band, BandedCholesky
from pipeline.stepping.warped import WarpedCG


def path(cases_folder, solver: str, variant: str, **keys: object) -> list[np.ndarray]:
    overrides = {"method.linear_solver": solver, "schedule.frames": 100, **keys}
    return [
        frame.x for frame in frames(build(load_case(cases_folder / "bar.toml", overrides=overrides).variant(variant)))
    ]


@pytest.mark.parametrize("variant", ["linear", "gram_schmidt", "polar", "converged"])
def test_all_solvers_give_the_same_trajectory(cases_folder, variant: str) -> None:
    runs = {name: path(cases_folder, name, variant) for name in LINEAR_SOLVERS}
    size = np.linalg.norm([4.0, 12.0, 4.0])
    for name, run in runs.items():
        apart = max(np.abs(a - b).max() for a, b in zip(run, runs["superlu"], strict=True))
        assert apart <= 1e-6 * size, name


@pytest.mark.parametrize("band_megabytes", [60.0, 0.0], ids=["banded", "sparse"])
def test_warped_takes_one_factor_for_the_whole_run(cases_folder, monkeypatch, band_megabytes: float) -> None:
    monkeypatch.setattr("pipeline.stepping.warped._BAND_MEGABYTES", band_megabytes)
    overrides = {"method.linear_solver": "warped", "schedule.frames": 10}
    run = frames(build(load_case(cases_folder / "bar.toml", overrides=overrides).variant("polar")))
    counts = [frame.work.factorisations for frame in run]
    assert counts == [0, 1, *[0] * 9]


def test_warped_without_its_optional_factor_gives_the_same(cases_folder, monkeypatch) -> None:
    with_any = path(cases_folder, "warped", "polar", **{"schedule.frames": 20})
    monkeypatch.setattr("pipeline.stepping.warped._BAND_MEGABYTES", 0.0)
    monkeypatch.setitem(__import__("sys").modules, "cholespy", None)  # as if it were not installed
    without = path(cases_folder, "warped", "polar", **{"schedule.frames": 20})
    assert np.abs(with_any[-1] - without[-1]).max() < 1e-5


@pytest.mark.parametrize("solver", [BandedCholesky, WarpedCG])
def test_an_indefinite_matrix_is_an_error(solver) -> None:
    from pipeline.fem.assembly import assemble_pattern

    pattern = assemble_pattern(box([1.0, 1.0, 1.0], [1, 1, 1])).pattern
    good = np.where((pattern.rows == pattern.indices)[:, None, None], np.eye(3), 0.0)
    bad = good.copy()
    bad[0] = np.diag([1.0, 1.0, -1.0])
    made = solver(pattern, 1e-8, lambda: good)
    b = np.zeros((8, 3))
    b[0, 2] = 1.0
    with pytest.raises(SolveError, match="not positive definite"):
        made.update(bad, lambda: np.broadcast_to(np.eye(3), (8, 3, 3)))
        made.solve(b, 0 * b)


def test_a_band_holds_every_entry_once() -> None:
    from pipeline.fem.assembly import assemble_pattern

    pattern = assemble_pattern(box([1.0, 2.0, 1.0], [2, 3, 2])).pattern
    rng = np.random.default_rng(0)
    values = rng.normal(size=(len(pattern.indices), 3, 3))
    full = pattern.matrix(values).toarray()
    full = full + full.T + 100 * np.eye(len(full))
    blocks = full.reshape(pattern.nodes, 3, pattern.nodes, 3)[pattern.rows, :, pattern.indices, :]
    solver = BandedCholesky(pattern)
    solver.update(blocks)
    b = rng.normal(size=(pattern.nodes, 3))
    x, _ = solver.solve(b, b)
    np.testing.assert_allclose(full @ x.ravel(), b.ravel(), atol=1e-12)
    assert Band(pattern).width < len(full)
