"""Displacement and rest state from evidence: names, shapes, noise and traps; each has its right value or a question."""

import itertools

import numpy as np
import pytest
import pyvista

from pipeline import read_series
from pipeline.errors import SeriesError
from pipeline.mesh.shapes import box
from pipeline.run.measures import measure
from tests.series.test_series import write_pvd

RNG = np.random.default_rng(11)
SOLID = box([2.0, 1.0, 1.0], [2, 1, 1])
X, CELLS = SOLID.points, SOLID.cells
PLATE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
STRETCHES = (1.0, 1.2, 1.5, 1.7)


def stretch(points, s):
    return points * [s, 1, 1]


def write(folder, frames, cells=CELLS, kind=10, fields="point"):
    """Write frames of (points, point fields) and return the path of the index."""
    folder.mkdir(exist_ok=True)
    for k, (points, data) in enumerate(frames):
        grid = pyvista.UnstructuredGrid({kind: np.asarray(cells)}, np.asarray(points))
        for name, values in data.items():
            (grid.point_data if fields == "point" else grid.cell_data)[name] = values
        grid.save(folder / f"f_{k}.vtu")
    return write_pvd(folder, [(0.1 * k, f"f_{k}.vtu") for k in range(len(frames))])


def ratios(path, **options):
    return [measure(frame)["volume_ratio"] for frame in read_series(path, **options)]


def assert_stretched(path, stretches=STRETCHES, rtol=1e-9, **options):
    for ratio, s in zip(ratios(path, **options), stretches, strict=True):
        assert ratio == pytest.approx(s, rel=rtol)


def rest_frames(name="displacement", shape=lambda u: u, points=X, scale=1.0):
    return [(points, {name: shape(scale * (stretch(points, s) - points))}) for s in STRETCHES]


# Points at rest


@pytest.mark.parametrize(
    "name",
    ["displacement", "Displacement", "DISPLACEMENT", "displacements", "disp", "Disp", "DISP", "disp_", "U_disp",
     "disp_solid", "nodal_displacement", "DISPL", "depl", "DEPL", "RESU____DEPL", "deplacement", "deformation",
     "Verschiebung", "desplazamiento", "pointDisplacement", "MeshDisplacement", "total displacement", "displ (m)",
     "displacement_vector", "u", "u_h", "uh", "u_n", "u0", "d", "D"],
)  # fmt: skip
def test_the_only_displacement_is_added_to_points_at_rest(tmp_path, name):
    path = write(tmp_path, rest_frames(name))
    assert_stretched(path)
    assert any(name in note for note in read_series(path).notes)


SHAPES = {
    "two components": lambda u: u[:, :2],
    "homogeneous": lambda u: np.column_stack([u, np.zeros(len(u))]),
    "shell": lambda u: np.column_stack([u, np.full((len(u), 3), 0.3)]),
    "single": lambda u: u.astype(np.float32),
    "integers": lambda u: u,
}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_displacement_has_two_to_six_components(tmp_path, shape):
    assert_stretched(write(tmp_path, rest_frames(shape=SHAPES[shape])), rtol=1e-6)


TRIPLES = [
    ("disp_x", "disp_y", "disp_z"), ("u_x", "u_y", "u_z"), ("ux", "uy", "uz"), ("Ux", "Uy", "Uz"),
    ("UX", "UY", "UZ"), ("DISPX", "DISPY", "DISPZ"), ("displ:0", "displ:1", "displ:2"), ("U:0", "U:1", "U:2"),
    ("U1", "U2", "U3"), ("disp[0]", "disp[1]", "disp[2]"), ("x_displacement", "y_displacement", "z_displacement"),
    ("displacement X", "displacement Y", "displacement Z"), ("disp_x", "disp_y"), ("u", "v", "w"),
]  # fmt: skip


@pytest.mark.parametrize("names", TRIPLES, ids=",".join)
def test_components_may_be_scalars(tmp_path, names):
    frames = []
    for s in STRETCHES:
        u = stretch(X, s) - X
        frames.append((X, {name: u[:, i].copy() for i, name in enumerate(names)} | {"stress_xx": 2 * u[:, 0]}))
    path = write(tmp_path, frames)
    assert_stretched(path)
    assert_stretched(path, displacement=",".join(names))
    assert_stretched(path, (1.0,) * 4, displacement="none")


@pytest.mark.parametrize("noise", [0, 1e-16, 1e-15, 1e-13, 1e-10, 1e-8])
def test_rest_points_may_have_rounding_noise(tmp_path, noise):
    frames = [(x + noise * RNG.uniform(-1, 1, X.shape) if k else x, data) for k, (x, data) in enumerate(rest_frames())]
    path = write(tmp_path, frames)
    assert_stretched(path, rtol=max(1e-9, 10 * noise))


def test_rest_points_in_single_precision_computed_as_x_minus_u(tmp_path):
    frames = []
    for s in STRETCHES:
        u = (stretch(X, s) - X).astype(np.float32)
        x = (X + np.array([1000.1, 0, 0])).astype(np.float32)
        frames.append(((x + u) - u, {"displacement": u}))
    assert_stretched(write(tmp_path, frames), rtol=1e-3)


@pytest.mark.parametrize("late", [1, 2, 3])
def test_a_displacement_that_comes_late_is_zero_before(tmp_path, late):
    frames = [(X, data if k >= late else {"T": np.zeros(len(X))}) for k, (_, data) in enumerate(rest_frames())]
    expected = [1.0] * late + list(STRETCHES[late:])
    path = write(tmp_path, frames)
    assert_stretched(path, expected)
    assert any("does not have the field" in note for note in read_series(path).notes)


def test_a_displacement_missing_in_the_middle_ends_the_numbers_of_that_frame(tmp_path):
    frames = [(x, {} if k == 2 else data) for k, (x, data) in enumerate(rest_frames())]
    series = read_series(write(tmp_path, frames))
    values = [measure(frame)["volume_ratio"] for frame in series]
    assert np.isnan(values[2]).all() and values[3] == pytest.approx(1.7)
    assert "no point field displacement" in series.read_frame(2).fault


def test_rest_is_the_points_even_if_the_first_frame_is_displaced(tmp_path):
    frames = [(X, {"displacement": stretch(X, s) - X}) for s in STRETCHES[1:]]
    assert_stretched(write(tmp_path, frames), STRETCHES[1:])
    assert_stretched(write(tmp_path, frames), [s / 1.2 for s in STRETCHES[1:]], rest="first")


FIXED = {
    "fiber": X * 0 + [0, 0, 1.0], "normals": X * 0 + [1, 0, 0.0], "velocity": X, "acceleration": X, "reaction": X,
    "Rotation": X, "body_force": X, "heat_flux": X, "a": X, "v": X,
}  # fmt: skip


@pytest.mark.parametrize("other", FIXED)
def test_other_vectors_do_not_disturb(tmp_path, other):
    frames = [(x, data | {other: FIXED[other] * k}) for k, (x, data) in enumerate(rest_frames())]
    assert_stretched(write(tmp_path / "clear", frames))
    frames = [(x, data | {other: FIXED[other] * k}) for k, (x, data) in enumerate(rest_frames("u"))]
    assert_stretched(write(tmp_path / "short", frames))
    moving = [(stretch(X, s), {other: FIXED[other] * k}) for k, s in enumerate(STRETCHES)]
    assert_stretched(write(tmp_path / "moving", moving))


def test_derived_fields_are_no_candidates(tmp_path):
    names = ["displacement_rate", "displacement_increment", "displacement_error", "prescribed_displacement", "dispdot"]
    frames = [(x, data | dict.fromkeys(names, 3 * data["displacement"])) for x, data in rest_frames()]
    assert_stretched(write(tmp_path, frames))


def test_the_same_displacement_twice_is_one(tmp_path):
    frames = [(x, data | {"disp": data["displacement"], "u": data["displacement"]}) for x, data in rest_frames()]
    assert_stretched(write(tmp_path, frames))


# Questions


def make_questions():
    u = [stretch(X, s) - X for s in STRETCHES]
    p = X[:, 0].copy()
    yield "two displacements", [(X, {"disp_a": a, "disp_b": 2 * a}) for a in u], ("disp_a", "disp_b")
    yield "D and U", [(X, {"D": a, "U": 5 * a}) for a in u], ("any of D, U: say",)
    yield "u and d", [(X, {"u": a, "d": 5 * a}) for a in u], ("u", "d")
    yield "flow from rest", [(X, {"U": a, "p": p}) for a in u], ("U",)
    yield "flow of FEniCS", [(X, {"u": a, "p": p}) for a in u], ("u",)
    yield "flow in three scalars", [(X, {"u": a[:, 0].copy(), "v": a[:, 1].copy(), "w": a[:, 2].copy(), "p": p})
                                    for a in u], ("u,v,w",)  # fmt: skip
    yield "flow in motion", [(X, {"U": a}) for a in u[1:]], ("U",)
    yield "unknown vector", [(X, {"strange": a}) for a in u], ("strange",)
    yield "unknown and short", [(X, {"strange": a, "u": a * 2}) for a in u], ("strange", "u")
    yield "late velocity", [(X, {"U": a} if k else {}) for k, a in enumerate(u)], ("U",)
    yield "zero displacement, moving u", [(X, {"displacement": 0 * a, "u": a}) for a in u], ("displacement", "u")
    yield "one frame", [(X, {"displacement": u[2]})], ("displacement", "one frame")
    yield "one frame with u", [(X, {"u": u[2]})], ("u", "one frame")
    yield "warped", [(X + 10 * a, {"displacement": a}) for a in u], ("10 times",)
    yield "a force from zero", [(X, {"f": a}) for a in u], ("f",)
    yield "two that the points contain", [(X + a, {"disp_a": a, "disp_b": a - u[1]}) for a in u[1:]], ("disp_b",)
    yield "real and imaginary part", [(X, {"disp_real": a, "disp_imag": 0 * a}) for a in u], ("disp_real",)
    yield "increments alone", [(X, {"displacement_increment": a}) for a in u], ("displacement_increment",)
    yield "one scalar", [(X, {"Ux": a[:, 0].copy()}) for a in u], ("Ux", "no vector")
    yield "a magnitude", [(X, {"displacement_magnitude": a[:, 0].copy()}) for a in u], ("displacement_magnitude",)
    yield "nine components", [(X, {"displacement": np.hstack([a, a, a])}) for a in u], ("displacement", "no vector")
    yield "half of it", [(X + 0.5 * a, {"displacement": a}) for a in u], ("0.5 times",)
    yield "another motion", [(X + a[:, [1, 0, 2]], {"displacement": a}) for a in u], ("not as the field",)
    yield "absurd unit", [(X, {"displacement": 1000 * a}) for a in u], ("times its size",)
    yield "inverted", [(X, {"displacement": -3 * a}) for a in u], ("inverts 100 %",)
    yield "motion of noise beside a velocity", [(X + 1e-9 * a, {"u": a}) for a in u], ("none",)


@pytest.mark.parametrize(("frames", "words"), [pytest.param(f, w, id=n) for n, f, w in make_questions()])
def test_what_evidence_does_not_decide_is_asked(tmp_path, frames, words):
    with pytest.raises(SeriesError) as caught:
        read_series(write(tmp_path, frames))
    text = str(caught.value)
    assert all(word in text for word in words) and "\n" not in text and "displacement" in text, text


@pytest.mark.parametrize("answer", ["D", "U"])
def test_the_answer_decides(tmp_path, answer):
    frames = [(X, {"D": stretch(X, s) - X, "U": 2 * (stretch(X, s) - X)}) for s in STRETCHES]
    path = write(tmp_path, frames)
    assert_stretched(path, [1 + (1 if answer == "D" else 2) * (s - 1) for s in STRETCHES], displacement=answer)
    assert_stretched(path, [1.0] * 4, displacement="none")


def test_a_cell_field_is_no_displacement(tmp_path):
    frames = [(X, {"displacement": np.full((len(CELLS), 3), 0.1 * k)}) for k in range(3)]
    path = write(tmp_path, frames, fields="cell")
    assert_stretched(path, [1.0] * 3)
    with pytest.raises(SeriesError, match="displacement is a cell field"):
        read_series(path, displacement="displacement")


def test_a_steady_vector_moves_nothing(tmp_path):
    path = write(tmp_path, [(X, {"u": X * [0.3, 0, 0]}) for _ in range(3)])
    assert_stretched(path, [1.0] * 3)
    assert any("at rest" in note for note in read_series(path).notes)


# Points that move


@pytest.mark.parametrize("name", ["displacement", "DISPLACEMENT", "u", "D", "depl", "odd"])
@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_points_that_contain_the_displacement_are_not_displaced_again(tmp_path, name, first, dtype):
    chosen = STRETCHES[first:]
    frames = [(stretch(X, s).astype(dtype), {name: (stretch(X, s) - X).astype(dtype)}) for s in chosen]
    path = write(tmp_path, frames)
    assert_stretched(path, chosen, rtol=1e-5)
    assert any(name in note and "not added" in note for note in read_series(path).notes)
    assert_stretched(path, chosen, rtol=1e-5, displacement=name)
    assert_stretched(path, [s / chosen[0] for s in chosen], rtol=1e-5, rest="first")


def test_an_increment_named_displacement_is_no_contradiction(tmp_path):
    x = [stretch(X, s) for s in STRETCHES]
    frames = [(b, {"displacement": b - a}) for a, b in zip([X, *x[:-1]], x, strict=True)]
    assert_stretched(write(tmp_path, frames))


def test_a_velocity_named_u_does_not_disturb_moving_points(tmp_path):
    assert_stretched(write(tmp_path, [(stretch(X, s), {"u": X * s, "p": X[:, 0].copy()}) for s in STRETCHES]))


@pytest.mark.parametrize("kind", ["deformed", "rest"])
@pytest.mark.parametrize("count", [1, 3])
def test_a_file_of_the_rest_state(tmp_path, kind, count):
    """Deformed points with a displacement, and a file of the rest state: the displacement counts once."""
    rest = tmp_path / "rest.vtu"
    pyvista.UnstructuredGrid({10: CELLS}, X).save(rest)
    chosen = STRETCHES[1 : 1 + count]
    frames = [(stretch(X, s) if kind == "deformed" else X, {"displacement": stretch(X, s) - X}) for s in chosen]
    path = write(tmp_path / "s", frames)
    assert_stretched(path, chosen, rest=rest)
    assert any("rest.vtu" in note for note in read_series(path, rest=rest).notes)


def test_rest_position_and_displacement(tmp_path):
    moved = [(stretch(X, s), {"rest_position": X, "displacement": stretch(X, s) - X}) for s in STRETCHES]
    assert_stretched(write(tmp_path / "a", moved))
    still = [(X, {"rest_position": X, "displacement": stretch(X, s) - X}) for s in STRETCHES]
    assert_stretched(write(tmp_path / "b", still))


@pytest.mark.parametrize("name", ["x", "place", "points", "current_position", "r"])
@pytest.mark.parametrize("shift", [0.0, 5.0])
def test_a_field_of_positions_is_no_displacement(tmp_path, name, shift):
    frames = [(stretch(X, s), {name: stretch(X, s) - shift}) for s in STRETCHES]
    assert_stretched(write(tmp_path, frames))


def test_forces_by_component_are_no_displacement(tmp_path):
    frames = [(X, {f"f{axis}": k * X[:, i] for i, axis in enumerate("xyz")}) for k in range(3)]
    assert_stretched(write(tmp_path, frames), [1.0] * 3)


def test_a_solution_that_diverges_in_the_end_is_measured(tmp_path):
    frames = [(X, {"displacement": s * X * [1, 0, 0]}) for s in (0, 0.1, 0.2, 0.3, 0.4, 1e3, -1e5)]
    assert_stretched(write(tmp_path, frames), [1, 1.1, 1.2, 1.3, 1.4, 1001, 1 - 1e5])


# Long series


@pytest.mark.parametrize("name", ["u", "strange"])
def test_a_field_that_changes_only_in_frames_not_looked_at_is_asked_about(tmp_path, name):
    path = write(tmp_path, [(X, {name: X * (k == 42)}) for k in range(100)])
    series = read_series(path)
    with pytest.raises(SeriesError, match=f"the field {name} changes, unlike in the frames looked at"):
        list(series)
    assert_stretched(path, [1.0] * 100, displacement="none")


def test_a_long_series_is_opened_by_some_of_its_frames(tmp_path, monkeypatch):
    from pipeline.series import series
    from pipeline.series.files import frame_files

    factors = np.linspace(1, 2, 200)
    path = write(tmp_path, [(X, {"displacement": stretch(X, s) - X}) for s in factors])
    read = []

    def count(file, *args, **options):
        read.append(file.name)
        return frame_files.read_grid(file, *args, **options)

    monkeypatch.setattr(series, "read_grid", count)
    opened = read_series(path)
    assert len(read) < 40
    assert any("of 200 frames" in note for note in opened.notes)
    assert measure(opened.read_frame(150))["volume_ratio"] == pytest.approx(factors[150])


@pytest.mark.parametrize("name", ["displacement", "u"])
def test_points_that_move_in_a_frame_not_looked_at_are_an_error(tmp_path, name):
    frames = [(X + (0.1 if k == 42 else 0.0), {name: stretch(X, 1 + k / 100) - X}) for k in range(100)]
    series = read_series(write(tmp_path, frames))
    with pytest.raises(SeriesError, match=r"t = 4.2 s: the points move"):
        for frame in series:
            measure(frame)


def test_a_displacement_that_only_frames_in_between_have_is_an_error(tmp_path):
    frames = [(X, {"displacement": X} if k == 42 else {}) for k in range(100)]
    series = read_series(write(tmp_path, frames))
    with pytest.raises(SeriesError, match="was not in the frames looked at"):
        list(series)


@pytest.mark.parametrize(("a", "b"), list(itertools.permutations(["T", "p", "alpha"], 2)))
def test_scalars_are_no_vectors(tmp_path, a, b):
    path = write(tmp_path, [(stretch(X, s), {a: X[:, 0].copy(), b: X[:, 1].copy()}) for s in STRETCHES])
    assert_stretched(path)
