"""Rotations of a deformation gradient: valid for every finite matrix, and the difference between the two methods."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from pipeline.fem.rotation import angle, axial, gram_schmidt, polar
from tests.bodies import make_rotation

ROTATIONS = {"polar": polar, "gram_schmidt": gram_schmidt}
RNG = np.random.default_rng(20240607)
EPS = np.finfo(float).eps
ROUNDING = 20 * EPS  # error of products of two orthonormal 3 x 3 matrices


def with_singular_values(d: int, values: list[float], count: int = 20) -> np.ndarray:
    """Matrices U diag(s) V^T with random rotations U and V."""
    turns = Rotation.random(2 * count, rng=RNG).as_matrix().reshape(2, count, 3, 3)
    if d == 2:
        a = RNG.uniform(-np.pi, np.pi, (2, count))
        turns = np.moveaxis(np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]), (0, 1), (2, 3))
    return turns[0] * np.array(values[:d]) @ np.swapaxes(turns[1], 1, 2)


def families(d: int) -> dict[str, np.ndarray]:
    normal = RNG.standard_normal((50, d, d))
    ends = np.array([1e-300, 1e-160, 1e-20, 1e20, 1e160, 1e300])
    return {
        "random": normal,
        "reflected": with_singular_values(d, [1.5, -0.4, 1.1] if d == 2 else [1.5, 1.1, -0.4]),
        "reflection": with_singular_values(d, [1.0, -1.0] if d == 2 else [1.0, 1.0, -1.0]),
        "flat": with_singular_values(d, [1.3, 0.0] if d == 2 else [1.3, 0.7, 0.0]),
        "nearly_flat": with_singular_values(d, [1.3, 1e-13] if d == 2 else [1.3, 0.7, 1e-13]),
        "rank_1": with_singular_values(d, [2.0, 0.0, 0.0]),
        "rank_0": np.zeros((1, d, d)),
        "minus_identity": -np.eye(d)[None],
        "half_turns": np.stack([make_rotation(d, axis, np.pi) for axis in RNG.standard_normal((20, 3))]),
        "scales": normal[:6] * ends[:, None, None],
        "uneven_columns": normal * np.array([1e-200, 1.0, 1e200])[:d],
        "subnormal": np.full((1, d, d), 5e-324),
        "largest": np.full((1, d, d), np.finfo(float).max),
        "first_column_null": normal * np.array([0.0, 1.0, 1.0])[:d],
        "columns_parallel": np.repeat(normal[:, :, :1], d, axis=2),
    }


FAMILIES = [pytest.param(F, id=f"{d}D-{name}") for d in (2, 3) for name, F in families(d).items()]
UNIQUE = ("random", "reflected", "flat", "half_turns", "scales")


def assert_rotations(R: np.ndarray) -> None:
    assert np.isfinite(R).all()
    assert np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(R.shape[-1])).max() < ROUNDING
    assert np.abs(np.linalg.det(R) - 1).max() < ROUNDING


@pytest.mark.parametrize("rotation", ROTATIONS)
@pytest.mark.parametrize("F", FAMILIES)
def test_a_rotation_comes_out_of_every_finite_matrix(rotation, F):
    before = F.copy()
    assert_rotations(ROTATIONS[rotation](F))
    assert np.array_equal(F, before)


@pytest.mark.parametrize("rotation", ROTATIONS)
@pytest.mark.parametrize("d", [2, 3])
@given(data=st.data())
def test_a_rotation_comes_out_of_any_finite_floats(rotation, d, data):
    numbers = st.floats(allow_nan=False, allow_infinity=False)
    assert_rotations(ROTATIONS[rotation](data.draw(arrays(np.float64, (1, d, d), elements=numbers))))


@pytest.mark.parametrize("F", FAMILIES)
def test_no_rotation_is_closer_than_the_polar_one(F):
    d = F.shape[-1]
    F = F / np.where(F.any(), np.abs(F).max(axis=(1, 2), keepdims=True), 1.0)  # squares of 1e300 are not finite
    others = with_singular_values(d, [1.0, 1.0, 1.0], count=500)
    # |F - R|^2 = |F|^2 + d - 2 R : F, so the closest has the largest R : F; rounding of that sum
    assert ((polar(F) * F).sum(axis=(1, 2)) > np.einsum("eij,qij->eq", F, others).max(axis=1) - 1e-13).all()


@pytest.mark.parametrize("name", UNIQUE)
def test_polar_is_the_best_fit_of_scipy(name):
    F = families(3)[name]
    F = F / np.abs(F).max(axis=(1, 2), keepdims=True)
    fits = np.stack([Rotation.align_vectors(gradient.T, np.eye(3))[0].as_matrix() for gradient in F])
    # both come from an SVD; how well a rotation is determined is (s2 + s3) / s1, here above 1e-3
    assert np.abs(polar(F) - fits).max() < 1e-12


@pytest.mark.parametrize("name", UNIQUE)
def test_plane_polar_is_that_of_space_with_a_stretched_third_axis(name):
    F = families(2)[name]
    F = F / np.abs(F).max(axis=(1, 2), keepdims=True)
    inside = np.zeros((len(F), 3, 3))
    inside[:, :2, :2], inside[:, 2, 2] = F, 5.0
    assert np.abs(polar(inside)[:, :2, :2] - polar(F)).max() < 1e-12  # as above


@pytest.mark.parametrize("F", FAMILIES)
def test_gram_schmidt_gives_an_upper_triangle(F):
    lengths = np.abs(F).max(axis=1, keepdims=True)
    F = F / np.where(lengths == 0, 1.0, lengths)  # column by column: only the directions matter
    T = np.swapaxes(gram_schmidt(F), 1, 2) @ F
    assert np.abs(np.tril(T, -1)).max() < 1e-14
    assert (np.diagonal(T, axis1=1, axis2=2)[:, :-1] > -1e-14).all()  # r_i points along a_i


@pytest.mark.parametrize("d", [2, 3])
def test_both_rotations_follow_the_body_but_only_polar_follows_the_axes(d):
    F, Q = RNG.standard_normal((50, d, d)), make_rotation(d, [1, -2, 0.5], 2.1)
    for rotation in ROTATIONS.values():
        assert np.abs(rotation(Q @ F) - Q @ rotation(F)).max() < 1e-11  # the worst of 50 is ill-conditioned
    assert np.abs(polar(F @ Q) - polar(F) @ Q).max() < 1e-11
    assert np.abs(gram_schmidt(F @ Q) - gram_schmidt(F) @ Q).max() > 0.1


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(
    ("rotation", "order", "degrees"),
    [
        (polar, (0, 1), -26.565051177),  # -atan(1/2)
        (polar, (1, 0), -26.565051177),
        (gram_schmidt, (0, 1), 0.0),
        (gram_schmidt, (1, 0), -45.0),
    ],
)
def test_the_rotation_of_a_shear_depends_on_the_order_of_the_axes_for_gram_schmidt_only(d, rotation, order, degrees):
    axes = [*order, 2][:d]
    F = np.eye(d)[None].copy()
    F[0, 0, 1] = 1.0
    R = rotation(F[:, axes][:, :, axes])
    back = R[:, np.argsort(axes)][:, :, np.argsort(axes)]
    assert np.degrees(np.arctan2(back[0, 1, 0], back[0, 0, 0])) == pytest.approx(degrees, abs=1e-9)
    assert np.degrees(angle(R)) == pytest.approx(abs(degrees), abs=1e-9)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("wanted", [0.0, 1e-9, 0.5, np.pi / 2, 3.0, np.pi - 1e-7, np.pi])
def test_the_angle_is_exact_from_zero_to_a_half_turn(d, wanted):
    axes = RNG.standard_normal((20, 3))
    R = np.stack([make_rotation(d, axis, sign * wanted) for axis in axes for sign in (1, -1)])
    # entries are rounded to 1e-16, and atan2 of both parts keeps that near 0 and near pi alike
    assert angle(R) == pytest.approx(np.full(40, wanted), abs=4e-15)


def test_the_axial_vector_gives_the_cross_product():
    w, a = RNG.standard_normal((2, 3))
    W = np.stack([np.cross(w, unit) for unit in np.eye(3)], axis=1)
    assert np.allclose(W @ a, np.cross(w, a), rtol=1e-14) and np.array_equal(axial(W), w)
