"""Cases made in Python: the same motion as from a file, functions of X and t, and what a result folder keeps."""

import numpy as np
import pytest

from pipeline import build, frames, load_case, make_case
from pipeline.errors import CaseError
from pipeline.mesh.shapes import box
from pipeline.mesh.simplex import Mesh
from pipeline.results.case_run import run_case
from tests.bodies import skip_figures, write_case

MATERIAL = {"youngs_modulus": 1e7, "poisson_ratio": 0.3, "density": 1000.0}
BEAM = box((1.0, 3.0, 1.0), (1, 3, 1))
STEPPERS = {
    "backward_euler": {"stepper": "backward_euler"},
    "converged": {"stepper": "backward_euler", "iterations": "converged"},
    "bdf2": {"stepper": "bdf2"},
    "auto": {"model": "auto"},
    "linear": {"law": "linear"},
    "symplectic_euler": {"stepper": "symplectic_euler"},
}


def beam(**sections):
    """A beam that is held at y = 3."""
    sections.setdefault("supports", [{"nodes": lambda X: X[:, 1] == 3.0}])
    sections.setdefault("schedule", {"dt": 1e-3, "frames": 4})
    return make_case("beam", mesh=sections.pop("mesh", BEAM), material=MATERIAL, **sections)


def last_positions(case):
    return list(frames(build(case)))[-1].x


@pytest.mark.parametrize("method", STEPPERS.values(), ids=STEPPERS)
def test_arrays_and_functions_move_as_the_file_does(method, tmp_path):
    variant = {f"method.{key}": value for key, value in method.items()}
    path = write_case(tmp_path, variants={"one": variant}, schedule={"dt": 1e-3, "frames": 4})
    from_file = last_positions(load_case(path).variant("one"))
    force = 1000.0 * np.array([0.0, 0.0, -9.81])
    case = beam(
        mesh=(BEAM.points.tolist(), BEAM.cells),
        loads={"body_force": lambda X, t: np.broadcast_to(force, X.shape)},
        initial={"velocity": lambda X: np.full(X.shape, [0.0, 0.0, -20.0])},
        method=method,
    )
    np.testing.assert_allclose(last_positions(case), from_file, rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", STEPPERS.values(), ids=STEPPERS)
def test_the_momentum_is_the_impulse_of_a_force_that_varies(method):
    dt, count = 1e-3, 20
    case = beam(
        supports=[],
        loads={"nodal_forces": lambda X, t: np.outer(1 + X[:, 0], [np.sin(300 * t), t, 0.0])},
        schedule={"dt": dt, "frames": count},
        method=method,
    )
    *_, last = frames(build(case))
    total = (1 + BEAM.points[:, 0]).sum()
    begins = np.arange(count) * dt  # the load that a step takes: at its end, or at its start if the step is explicit
    times = begins if method.get("stepper") == "symplectic_euler" else begins + dt
    if method.get("stepper") == "bdf2":
        p = np.zeros((count + 1, 2))
        f = total * np.stack([np.sin(300 * times), times], axis=1)
        p[1] = dt * f[0]
        for n in range(1, count):
            p[n + 1] = (4 * p[n] - p[n - 1]) / 3 + 2 * dt / 3 * f[n]
        expected = p[-1]
    else:
        expected = dt * total * np.array([np.sin(300 * times).sum(), times.sum()])
    np.testing.assert_allclose(last.known["linear_momentum"][:2], expected, atol=1e-7 * expected.max())
    load = total_load(case, count * dt)
    assert last.known["potential_energy"] == pytest.approx(-np.vdot(load, last.x - BEAM.points), rel=1e-9)


def total_load(case, time):
    return build(case).body.load_at(time)


def test_a_linear_body_force_is_integrated_exactly():
    case = beam(loads={"body_force": np.outer(BEAM.points[:, 1], [0.0, 0.0, 2.0])}, supports=[])
    load = build(case).body.load
    assert load[:, 2].sum() == pytest.approx(2.0 * 4.5)  # of y over [0, 3], unit cross-section
    assert BEAM.points[:, 1] @ load[:, 2] == pytest.approx(2.0 * 9.0, rel=0.06)  # the moment, by shape functions


def test_a_prescribed_motion_is_where_the_function_says():
    def pull(X, t):
        return np.stack([0.1 * np.sin(20 * t) * X[:, 2], 0 * X[:, 0], 0 * X[:, 0]], axis=1)

    supports = [{"nodes": BEAM.points[:, 1] == 3.0}, {"nodes": BEAM.points[:, 1] == 0.0, "motion": pull}]
    pulled = BEAM.points[:, 1] == 0.0
    for frame in frames(build(beam(supports=supports))):
        expected = BEAM.points[pulled] + pull(BEAM.points[pulled], frame.time)
        np.testing.assert_array_equal(frame.x[pulled], expected)
    start = build(beam(supports=supports)).start.v[pulled]
    np.testing.assert_allclose(start[:, 0], 2.0 * BEAM.points[pulled][:, 2], rtol=1e-6)


def test_mirrored_cells_are_reoriented_and_the_mesh_may_be_planar():
    triangles = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), np.array([[0, 2, 1], [0, 3, 2]])
    case = make_case("sheet", mesh=triangles, material=MATERIAL, schedule={"dt": 0.01, "frames": 1})
    assert (build(case).body.mesh.rest_volumes == 0.5).all()


def waves(speed):
    return lambda X, t: np.stack([np.sin(speed * t) + 0 * X[:, 0]] * 3, axis=1)


def test_a_result_is_kept_compared_and_described(tmp_path, monkeypatch):
    skip_figures(monkeypatch)
    case = beam(loads={"body_force": waves(3.0)}, variants={"linear": {"method.law": "linear"}, "polar": {}})
    first = run_case(case, tmp_path)
    assert [variant.status for variant in first.variants] == ["finished", "finished"]
    again = run_case(beam(loads={"body_force": waves(3.0)}, variants=case.variants), tmp_path)
    assert [variant.status for variant in again.variants] == ["up to date", "up to date"]
    with pytest.raises(CaseError, match=r"loads\.body_force_field: function <lambda>, sha256 \w+ there"):
        run_case(beam(loads={"body_force": waves(4.0)}, variants=case.variants), tmp_path)
    read = load_case(tmp_path / "beam" / "case.toml")
    assert read.mesh == case.mesh and read.loads == case.loads
    with pytest.raises(CaseError, match=r"mesh\.arrays: was given in Python .* make the case in Python again"):
        build(read.variant("polar"))


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"mesh": (np.zeros((4, 3)), np.zeros((1, 3), int))}, r"mesh: points have shape \(4, 3\) and cells \(1, 3\)"),
        ({"loads": {"body_force": np.zeros((2, 3))}}, r"loads\.body_force_field: has shape \(2, 3\), not \(16, 3\)"),
        ({"loads": {"nodal_forces": lambda X: X / 0 * np.nan}}, r"loads\.nodal_forces: 48 values are not finite"),
        ({"loads": {"body_force": "down"}}, r"loads\.body_force: 'down' is not a table"),
        ({"supports": [{"nodes": lambda X: X[:, 1] > 9}]}, r"supports\.0\.nodes: selects no node; the mesh spans"),
        ({"supports": [{"nodes": np.array([True])}]}, r"supports\.0\.nodes: the mask has shape \(1,\), not \(16,\)"),
        ({"supports": [{"nodes": [0], "motion": lambda X, t: X + 1}]}, r"supports\.0\.motion: moves a node by 1 m"),
        ({"schedule": {"dt": -0.1, "frames": 1}}, r"beam \(made in Python\): schedule\.dt: -0\.1 is not positive"),
        ({"methods": {}}, r'methods: unknown key; did you mean "method"\?'),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_message(sections, message):
    with pytest.raises(CaseError, match=message):
        beam(**sections)


def test_a_file_cannot_have_what_only_python_can_give(tmp_path):
    with pytest.raises(CaseError, match="is neither an array nor a function; only make_case takes those"):
        load_case(write_case(tmp_path, loads={"nodal_forces": [1.0]}))


def test_a_case_from_python_is_a_case():
    case = beam()
    assert isinstance(case.variant("default"), type(case)) and case.schedule.frames == 4
    assert isinstance(build(case).body.mesh, Mesh)
    assert case == beam() and case != beam(initial={"velocity": np.ones((16, 3))})


def make_pulse(size):
    """A push that lasts for a moment between two of the sampled times."""
    return lambda X, t: np.full(X.shape, size if 0.0006 < t < 0.0007 else 0.0)


STRENGTH = 1.0


def push_by_constant(X, t):
    return np.full(X.shape, STRENGTH if 0.0006 < t < 0.0007 else 0.0)


def test_functions_that_differ_between_the_sampled_times_are_different_cases(monkeypatch):
    assert beam(loads={"body_force": make_pulse(1.0)}) == beam(loads={"body_force": make_pulse(1.0)})
    assert beam(loads={"body_force": make_pulse(1.0)}) != beam(loads={"body_force": make_pulse(2.0)})
    tables = [{"forces": [np.arange(5000.0), np.full(5000, last)]} for last in (1.0, 1.0, 2.0)]  # repr shortens these
    first, same, other = (beam(loads={"body_force": lambda X, t, table=table: 0 * X}) for table in tables)
    assert first == same and first != other
    before = beam(loads={"body_force": push_by_constant})
    monkeypatch.setitem(globals(), "STRENGTH", 2.0)
    assert before != beam(loads={"body_force": push_by_constant})
