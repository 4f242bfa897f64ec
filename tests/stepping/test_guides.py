"""Supports along some axes only: rollers and planes of symmetry, against closed forms and whole bodies."""

import numpy as np
import pytest

from pipeline.case import load_case
from pipeline.errors import CaseError
from pipeline.fem import guides
from pipeline.fem.modes import find_lowest_frequencies
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.quadratic import raise_order
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.simplex import Mesh
from pipeline.problem.check import check_problem, format_check
from pipeline.problem.methods import LINEAR_SOLVERS, MODE_FACTORS
from pipeline.problem.problem import Problem, build
from pipeline.run.frame_iterator import frames
from pipeline.stepping.energy_guard import work_of_supports
from pipeline.stepping.symplectic_euler import element_limit, true_limit
from tests.bodies import build_problem, write_case

METHODS = {
    "linear": {"law": "linear"},
    "one solve": {},
    "three solves": {"iterations": 3},
    "converged": {"iterations": "converged"},
    "auto": {"model": "auto"},
    "bdf2": {"stepper": "bdf2"},
    "linear bdf2": {"stepper": "bdf2", "law": "linear"},
    "converged bdf2": {"stepper": "bdf2", "iterations": "converged"},
    "explicit": {"stepper": "symplectic_euler", "mass": "lumped"},
}
METHOD = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
ORDER = pytest.mark.parametrize("order", [1, 2])
ROLLERS = [{"plane": axis, "at": 0.0, "components": [axis]} for axis in "xyz"]
BARE = {"supports": None, "loads": None, "initial": None, "variants": None}


def build_block(folder, rest: ElementMesh | None = None, **sections: object) -> Problem:
    case = load_case(write_case(folder, **BARE | sections))
    return build(case.variant("default"), mesh=rest)


def mirror(mesh: Mesh, axis: int) -> tuple[Mesh, np.ndarray]:
    """Return the mesh joined with its mirror image at 0, and the number of each node's image in it."""
    n, on_plane = len(mesh.points), mesh.points[:, axis] == 0.0
    image = np.arange(n)
    image[~on_plane] = n + np.arange(n - on_plane.sum())
    points = mesh.points[~on_plane].copy()
    points[:, axis] *= -1
    cells = np.concatenate([mesh.cells, image[mesh.cells][:, [1, 0, *range(2, mesh.cells.shape[1])]]])
    return Mesh(np.concatenate([mesh.points, points]), cells), image


@ORDER
@pytest.mark.parametrize("method", [METHODS["linear"], METHODS["one solve"], METHODS["converged"]], ids=str)
@pytest.mark.parametrize("dt", [1e5, 1e9])
def test_a_block_between_planes_of_symmetry_stretches_uniformly(tmp_path, order, method, dt):
    E, nu, s, size = 1e7, 0.3, 2e5, (1.0, 3.0, 2.0)
    one = build_block(
        tmp_path,
        mesh={"shape": "box", "size": list(size), "cells": [2, 2, 1], "order": order},
        supports=ROLLERS,
        loads={"traction": [{"plane": "y", "at": 3.0, "normal_traction": s}]},
        method=method,
        schedule={"dt": dt, "frames": 2},
    )
    *_, last = frames(one)
    X = one.body.mesh.points
    exact = X * (1 + s / E * np.array([-nu, 1.0, -nu]))
    assert np.abs(last.x - exact).max() < 1e-11
    for axis in range(3):
        assert (last.x[X[:, axis] == 0.0, axis] == 0.0).all()


@ORDER
def test_a_planar_block_between_lines_of_symmetry_stretches_uniformly(tmp_path, order):
    E, nu, s = 1e7, 0.3, 2e5
    one = build_block(
        tmp_path,
        mesh={"shape": "rectangle", "size": [1.0, 3.0], "cells": [2, 3], "order": order},
        supports=ROLLERS[:2],
        loads={"traction": [{"plane": "y", "at": 3.0, "normal_traction": s}]},
        method={"iterations": "converged"},
        schedule={"dt": 1e6, "frames": 2},
    )
    *_, last = frames(one)
    exact = one.body.mesh.points * (1 + s / E * np.array([-nu * (1 + nu), 1 - nu**2]))
    assert np.abs(last.x - exact).max() < 1e-11


# A quarter of a body moves like the whole


def build_quarter_and_whole(folder, order: int, planar: bool, **sections: object) -> tuple[Problem, Problem]:
    """A beam along z (y in the plane), held at its top; its quarter has guides on the planes x = 0 and y = 0."""
    part = rectangle((0.6, 3.0), (1, 3)) if planar else box((0.5, 0.4, 2.0), (1, 1, 2))
    along, axes = ("y", [0]) if planar else ("z", [0, 1])
    top = {"plane": along, "at": float(part.points[:, -1].max())}
    whole = part
    for axis in axes:
        whole, _ = mirror(whole, axis)
    meshes = [raise_order(mesh) if order == 2 else mesh for mesh in (part, whole)]
    load = {"gravity": [0.0] * len(axes) + [-9.81]}
    initial = {"velocity": [0.0] * len(axes) + [8.0]}
    material = {"youngs_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0}
    keys = {"material": material, "loads": load, "initial": initial, "schedule": {"dt": 0.01, "frames": 12}} | sections
    guided = [top, *ROLLERS[: len(axes)]]
    quarter = build_block(folder, meshes[0], supports=guided, **keys)
    return quarter, build_block(folder, meshes[1], supports=[top], **keys)


def compare_parts(quarter: Problem, whole: Problem) -> float:
    """Return how far the quarter's nodes are from the same nodes of the whole, after its motion."""
    *_, part = frames(quarter)
    *_, full = frames(whole)
    X, Y = quarter.body.mesh.points, whole.body.mesh.points
    same = np.array([np.flatnonzero((x == Y).all(axis=1))[0] for x in X])
    assert np.abs(part.x - X).max() > 0.05
    return float(np.abs(part.x - full.x[same]).max())


@METHOD
@ORDER
@pytest.mark.parametrize("planar", [True, False], ids=["plane", "space"])
def test_a_quarter_moves_like_the_whole(tmp_path, method, order, planar):
    dt = 2e-4 if "stepper" in method and method["stepper"] == "symplectic_euler" else 0.01
    sections = {"method": method | {"linear_rtol": 1e-13, "tolerance": 1e-12}, "schedule": {"dt": dt, "frames": 12}}
    if dt < 0.01:
        sections["schedule"] = {"dt": dt, "frames": 4, "steps_per_frame": 20}
    assert compare_parts(*build_quarter_and_whole(tmp_path, order, planar, **sections)) < 1e-9


@pytest.mark.parametrize("solver", LINEAR_SOLVERS)
@ORDER
def test_a_quarter_moves_like_the_whole_with_every_solver(tmp_path, solver, order):
    method = {"linear_solver": solver, "linear_rtol": 1e-13}
    quarter, whole = build_quarter_and_whole(tmp_path, order, False, method=method)
    assert compare_parts(quarter, whole) < 1e-9


def test_a_quarter_has_the_symmetric_modes_of_the_whole(tmp_path):
    quarter, whole = build_quarter_and_whole(tmp_path, 1, False)
    few, modes = find_lowest_frequencies(quarter.body, 3)
    all_of_them, _ = find_lowest_frequencies(whole.body, 30)
    for omega in few:
        assert np.abs(all_of_them / omega - 1).min() < 1e-9
    X = quarter.body.mesh.points
    assert not modes[:, X[:, 0] == 0.0, 0].any() and modes[:, X[:, 0] == 0.0, 1].any()


def test_the_explicit_limit_is_that_of_the_free_components(tmp_path):
    method = {"stepper": "symplectic_euler", "mass": "lumped"}
    quarter, whole = build_quarter_and_whole(tmp_path, 1, False, method=method, schedule={"dt": 1e-4, "frames": 1})
    body = quarter.body
    _, K = body.linearize(body.mesh.points)
    dense = body.pattern.matrix(K).toarray()[np.ix_(body.free_components, body.free_components)]
    root = np.sqrt(np.repeat(body.lumped_mass, 3)[body.free_components])
    omega = np.sqrt(np.linalg.eigvalsh(dense / root / root[:, None])[-1])
    assert true_limit(body) == pytest.approx(2 / omega, rel=1e-8)
    assert element_limit(body) < true_limit(whole.body) <= true_limit(body) * (1 + 1e-9)


# Rollers


@METHOD
def test_momentum_along_the_free_axes_is_kept(tmp_path, method):
    dt = 5e-4 if "stepper" in method and method["stepper"] == "symplectic_euler" else 0.02
    one = build_block(
        tmp_path,
        supports=[{"plane": "z", "at": 0.0, "components": ["z"]}],
        initial={"velocity": [1.0, -2.0, 4.0], "spin": {"axis": [0.0, 0.0, 1.0], "rate": 200.0}},
        method=method | {"linear_rtol": 1e-13, "tolerance": 1e-12},
        schedule={"dt": dt, "frames": 20},
    )
    table = one.body.mesh.points[:, 2] == 0.0
    states = list(frames(one))
    first = one.body.momentum(states[0].v).sum(axis=0)
    for frame in states:
        assert (frame.x[table, 2] == 0.0).all() and (frame.v[table, 2] == 0.0).all()
        after = one.body.momentum(frame.v).sum(axis=0)
        assert np.abs(after - first)[:2].max() < 1e-8 * np.abs(first).max()
    assert np.abs(states[-1].x[table] - one.body.mesh.points[table])[:, :2].max() > 1e-2


@METHOD
def test_components_are_exactly_on_their_motion(tmp_path, method):
    """The foot is pulled along y and slides along x; the top is held."""
    dt = 5e-4 if "stepper" in method and method["stepper"] == "symplectic_euler" else 0.02
    pull = {"plane": "y", "at": 0.0, "components": ["y"], "motion": {"velocity": [0.0, -0.5, 0.0]}}
    turn = {"axis": [0.0, 0.0, 1.0], "rate": 30.0, "center": [0.5, 3.0, 0.5]}
    slope = {"plane": "y", "at": 3.0, "components": ["x", "y"], "motion": {"spin": turn}}
    one = build_block(tmp_path, supports=[pull, slope], method=method, schedule={"dt": dt, "frames": 10})
    X = one.body.mesh.points
    low, high = X[:, 1] == 0.0, X[:, 1] == 3.0
    assert (one.start.v[low, 1] == -0.5).all() and not one.start.v[low, 0].any() and not one.start.v[~high, 2].any()
    before = None
    for frame in frames(one):
        assert (frame.x[low, 1] == -0.5 * frame.time).all()
        angle = np.radians(30.0) * frame.time
        c, s = np.cos(angle), np.sin(angle)
        turned = (X[high, :2] - [0.5, 3.0]) @ np.array([[c, s], [-s, c]]) + [0.5, 3.0]
        assert np.abs(frame.x[high, :2] - turned).max() < 1e-14
        if before is not None and frame.state is not None:
            moved = (frame.x - before.x)[low, 1]
            reaction = one.body.momentum(frame.v - before.v) / dt - one.body.force(frame.x)
            rise = (frame.x - before.x)[high, :2]
            work = np.abs(reaction[low, 1] * moved).sum() + np.abs(reaction[high, :2] * rise).sum()
            assert work_of_supports(one.body, before.state, frame.state, dt) == pytest.approx(work, rel=1e-9)
        before = frame


def test_a_node_may_be_held_by_several_supports_along_different_axes(tmp_path):
    lift = {"plane": "y", "at": 0.0, "components": ["z"], "motion": {"velocity": [0.0, 0.0, 0.3]}}
    rest = {"plane": "y", "at": 0.0, "components": ["x", "y"]}
    one = build_block(tmp_path, supports=[lift, rest], schedule={"dt": 0.02, "frames": 5})
    assert not len(one.body.supports.nodes)
    X = one.body.mesh.points
    foot = X[:, 1] == 0.0
    *_, last = frames(one)
    assert np.array_equal(last.x[foot], X[foot] + [0.0, 0.0, 0.3 * last.time])
    # held along all axes and at rest, nodes are as if one support held them
    still = build_block(tmp_path, supports=[{**rest}, {"plane": "y", "at": 0.0, "components": ["z"]}])
    assert np.array_equal(still.body.supports.nodes, np.flatnonzero(foot)) and still.body.supports.guides is None


@pytest.mark.parametrize("stepper", MODE_FACTORS)
def test_a_second_stepper_goes_on_to_the_last_bit(tmp_path, stepper):
    slide = {"plane": "y", "at": 0.0, "components": ["y"], "motion": {"velocity": [0.0, -0.5, 0.0]}}
    sections = {"supports": [slide, {"plane": "y", "at": 3.0}], "loads": {"gravity": [0.0, 0.0, -9.81]}}
    one = build_block(tmp_path, **sections, method={"stepper": stepper, "linear_solver": "warped"})
    stepper_1, state = one.prepare(), one.start
    for _ in range(6):
        state, _ = stepper_1.step(state)
    middle, stepper_2 = state, one.prepare()
    for _ in range(3):
        state, _ = stepper_1.step(state)
        middle, _ = stepper_2.step(middle)
    assert np.array_equal(state.x, middle.x) and np.array_equal(state.v, middle.v)


def test_a_case_without_guides_never_makes_a_cut(tmp_path, monkeypatch):
    monkeypatch.setattr(guides.GuideCut, "__init__", None)
    whole = {"plane": "y", "at": 3.0, "components": ["z", "x", "y"]}
    ends = []
    for supports in ([whole], [{"plane": "y", "at": 3.0}]):
        one = build_block(tmp_path, supports=supports, loads={"gravity": [0.0, 0.0, -9.81]})
        assert one.body.supports.guides is None and one.body.guided_positions(0.0) is None
        *_, last = frames(one)
        ends.append(last.x)
    assert np.array_equal(*ends)


# Preconditioners


@pytest.mark.parametrize("solver", ["warped", "multigrid"])
def test_guides_cost_few_iterations(tmp_path, solver):
    """A beam on rollers that turn about them by a right angle is as quick to solve as one that is clamped."""
    counts = []
    for foot in ({"components": ["y", "z"]}, {}):
        one = build_block(
            tmp_path,
            mesh={"shape": "box", "size": [1.0, 8.0, 1.0], "cells": [3, 24, 3]},
            supports=[{"plane": "y", "at": 0.0, **foot}],
            loads={"gravity": [0.0, 0.0, -9.81]},
            method={"linear_solver": solver, "linear_rtol": 1e-6},
            schedule={"dt": 0.1, "frames": 15},
        )
        counts.append(sum(f.work.linear_iterations for f in frames(one) if f.work))
    assert counts[0] <= 1.3 * counts[1]


# Refusals


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"supports": [{"plane": "y", "at": 3.0, "components": []}]}, "supports.0.components: is empty"),
        (
            {"supports": [{"plane": "y", "at": 3.0, "components": ["x", "w"]}]},
            "supports.0.components.1: 'w' is not one of x, y, z",
        ),
        (
            {"supports": [{"plane": "y", "at": 3.0, "components": ["x", "x"]}]},
            "supports.0.components.1: 'x' is listed twice",
        ),
        ({"supports": [{"plane": "y", "at": 3.0, "components": "x"}]}, "supports.0.components: 'x' is not a list"),
        (
            {
                "supports": [
                    {"plane": "y", "at": 3.0, "components": ["z"], "motion": {"velocity": [0.0, 0.0, 1.0]}},
                    {"plane": "y", "at": 3.0},
                ]
            },
            "supports.1: node 6 is already held along z by supports.0",
        ),
        (
            {"supports": [{"plane": "y", "at": 3.0, "components": ["x"], "motion": {"velocity": [1.0, 0.0, 2.0]}}]},
            "supports.0.motion.velocity: moves the nodes along z, which is not one of the components x",
        ),
        (
            {
                "supports": [{"below": {"axis": "y", "at": 9.0}, "components": ["x"]}, {"nodes": [0, 1]}] * 1
                + [{"below": {"axis": "y", "at": 9.0}, "components": ["y", "z"]}]
            },
            "supports: all 16 nodes are held; no free node is left",
        ),
        (
            {
                "mesh": {"shape": "rectangle", "size": [1.0, 3.0], "cells": [1, 3]},
                "supports": [{"plane": "y", "at": 3.0, "components": ["x", "z"]}],
            },
            "supports.0.components.1: 'z' is not an axis of a planar mesh",
        ),
    ],
)
def test_components_that_cannot_be_held_are_refused(tmp_path, sections, message):
    with pytest.raises(CaseError) as caught:
        build_block(tmp_path, **sections)
    text = str(caught.value).split(".toml: ", 1)[1]
    assert text.startswith(message) and "\n" not in text


def test_the_body_says_how_many_components_its_guides_hold(tmp_path):
    one = build_problem(tmp_path, supports=[{"plane": "y", "at": 0.0, "components": ["x", "y"]}])
    assert repr(one.body.supports) == "<Supports: 0 held nodes, 0 motions, <Guides: 8 held components, 0 motions>>"
    assert len(one.body.free_components) == one.body.mesh.points.size - 8
    row = "nodes        16, of which 0 are held, 4 along some axes only"
    assert row in format_check(check_problem(one), one)
