"""Every formula of the thesis that is printed wrong and runs: it fails as described, and ours does not."""

import numpy as np
import pytest

from pipeline import build, frames, load_case
from pipeline.fem.element import deformation_gradient, nodal_forces, stiffness_blocks
from pipeline.fem.laws import Corotational, Linear
from pipeline.fem.material import Material
from pipeline.studies.thesis.corrections import TESTS, make_dense, run_corrections
from pipeline.studies.thesis.formulas_as_printed import force_6_12, step_4_48, stiffness_4_30, stiffness_4_32
from pipeline.studies.thesis.published import CORRECTIONS
from tests.bodies import BOXES, MATERIAL

MESH = BOXES["tetrahedra"]
RUN = [row.test for row in CORRECTIONS if row.test]


@pytest.fixture(scope="module")
def bar(cases_folder):
    return build(load_case(cases_folder / "bar_small_as_printed.toml").variant("linear"))


@pytest.fixture(scope="module")
def numbers(bar):
    """Test of a correction -> (numbers of the printed formula, of the corrected one)."""
    return {name: TESTS[name](bar) for name in RUN}


def our_stiffness(mesh, material=MATERIAL):
    one = np.broadcast_to(np.eye(3), (len(mesh.cells), 3, 3))
    return stiffness_blocks(mesh, Linear(material).tangent(one, one))


@pytest.mark.parametrize("formula", [stiffness_4_30, stiffness_4_32])
@pytest.mark.parametrize("nu", [-0.4, 0.0, 0.33, 0.49])
def test_only_the_corrected_element_matrices_equal_ours(formula, nu):
    material = Material(3e6, nu, 900.0)
    ours = our_stiffness(MESH, material)
    scale = np.abs(ours).max()
    assert np.abs(formula(MESH, material, corrected=True) - ours).max() < 1e-13 * scale
    assert np.abs(formula(MESH, material) - ours).max() > 1e-3 * scale


def test_4_30_as_printed_is_asymmetric_indefinite_and_resists_two_rotations(numbers):
    printed, ours = numbers["third_sum"]
    assert printed["asymmetry"] > 0.1 and ours["asymmetry"] < 1e-14
    assert (printed["kernel"], ours["kernel"]) == (4, 6)
    assert printed["lowest"] < -0.01 and abs(ours["lowest"]) < 1e-14
    assert printed["about_x"] > 0.1 and printed["about_y"] > 0.1 and printed["about_z"] < 1e-14
    assert max(ours[f"about_{axis}"] for axis in "xyz") < 1e-14


def test_4_32_as_printed_is_asymmetric_indefinite_and_unstable(numbers):
    printed, ours = numbers["left_factor"]
    assert printed["asymmetry"] > 0.1 and ours["asymmetry"] < 1e-14
    assert printed["lowest"] < -0.01 and abs(ours["lowest"]) < 1e-14
    assert printed["travel"] > 100 and ours["travel"] < 2  # metres; the bar is 12 m long


def test_4_48_as_printed_amplifies_every_mode_and_falls_upward(numbers):
    printed, ours = numbers["load_sign"]
    assert printed["growth"] == pytest.approx(printed["theory"], rel=1e-9) and printed["theory"] > 1.5
    assert ours["growth"] == pytest.approx(ours["theory"], rel=1e-9) and ours["theory"] < 0.9
    assert printed["rise"] > 0 > ours["rise"]
    assert printed["travel"] > 1e10 and ours["travel"] < 2


def test_6_16_as_printed_moves_a_resting_body(numbers):
    printed, ours = numbers["rest_force"]
    assert printed["share"] == pytest.approx(1.0, rel=1e-12)  # the residual is -2 K x
    assert printed["jump"] > 1.0  # m
    # rounding of forces of 1e10 N
    assert ours["residual"] < 1e-15 * printed["residual"] * 100 and ours["jump"] < 1e-12


def test_the_corrected_step_equals_ours(bar):
    system = make_dense(bar)
    K = system.restrict(our_stiffness(bar.body.mesh))
    u, v = np.zeros_like(system.v), system.v
    for frame in list(frames(bar))[1:6]:
        u, v = step_4_48(system.M, K, system.f, u, v, bar.dt, corrected=True)
        moved = (frame.x - frame.mesh.points)[bar.body.free].ravel()
        assert np.abs(u - moved).max() < 1e-11 * np.abs(moved).max()


def test_the_corrected_warped_force_is_that_of_the_corotational_law():
    """f_0 - K'(u + x) with the rotations of where the body is, assembled cell by cell."""
    rng = np.random.default_rng(1)
    law = Corotational(MATERIAL)
    x = MESH.points + 0.3 * rng.standard_normal(MESH.points.shape)
    F = deformation_gradient(MESH, x)
    R = law.rotations(F)
    ours = nodal_forces(MESH, law.stress(F, R))
    found = np.zeros_like(x)
    for cell, K, turn in zip(MESH.cells, our_stiffness(MESH).reshape(-1, 12, 12), R, strict=True):
        T = np.kron(np.eye(4), turn)
        X, p = MESH.points[cell].ravel(), x[cell].ravel()
        f = force_6_12(T @ K @ T.T, np.zeros(12), X, p - X, T @ K @ X, corrected=True)
        found[cell] += f.reshape(4, 3)
    assert np.abs(found - ours).max() < 1e-12 * np.abs(ours).max()


def test_every_correction_that_runs_has_its_numbers(bar):
    rows = run_corrections(bar)
    assert {row.test for row, _, _ in rows if row.test} == set(TESTS)
    for row, printed, corrected in rows:
        assert bool(row.test) == bool(printed) == bool(corrected)
        assert "{" not in printed + corrected
