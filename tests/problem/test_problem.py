"""From a case to a problem: selections, loads, initial states and supports are those of the case, or refused."""

import pickle
from itertools import islice

import meshio
import numpy as np
import pytest

from pipeline import build, frames, load_case
from pipeline.errors import CaseError
from pipeline.fem.supports import rotation_about
from tests.bodies import PLANAR, write_case

BAR = {"shape": "box", "size": [4.0, 12.0, 4.0], "cells": [2, 8, 2]}
AT_REST = {"loads": None, "initial": None}


@pytest.fixture
def problem(tmp_path):
    def of(variant="polar", **sections):
        return build(load_case(write_case(tmp_path, **sections)).variant(variant))

    return of


@pytest.fixture
def refused(tmp_path):
    def of(**sections) -> str:
        with pytest.raises(CaseError) as caught:
            build(load_case(write_case(tmp_path, **sections)).variant("polar"))
        text = str(caught.value)
        assert text.startswith(f"{tmp_path / 'beam.toml'}: ") and "\n" not in text
        return text.removeprefix(f"{tmp_path / 'beam.toml'}: ")

    return of


@pytest.mark.parametrize(
    ("selector", "count"),
    [
        ({"plane": "y", "at": 12.0}, 9),
        ({"plane": "x", "at": 2.0}, 27),
        ({"box": [[0.0, 0.0, 0.0], [2.0, 1.5, 4.0]]}, 12),
        ({"sphere": {"center": [0.0, 0.0, 0.0], "radius": 2.0}}, 4),
        ({"below": {"axis": "y", "at": 3.0}}, 18),  # strictly
        ({"above": {"axis": "z", "at": 2.0}}, 27),
        ({"nodes": [5, 0, 5]}, 2),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_a_selector_holds_the_nodes_that_it_describes(problem, selector, count):
    assert len(problem(mesh=BAR, supports=[selector]).body.supports.nodes) == count


def test_selectors_add_up_and_the_free_nodes_are_the_rest(problem):
    body = problem(mesh=BAR, supports=[{"plane": "y", "at": 12.0}, {"plane": "z", "at": 0.0}]).body
    assert len(body.supports.nodes) == 9 + 27 - 3 and len(body.free) == 81 - 33
    assert not set(body.free) & set(body.supports.nodes)


@pytest.mark.parametrize("where", ["size", "large", "offset"])
def test_a_plane_selects_its_nodes_at_any_scale(problem, where):
    size = {"size": [0.1, 0.3, 0.1], "large": [1e6, 3e6, 1e6], "offset": [1.0, 3.0, 1.0]}[where]
    mesh = {"shape": "box", "size": size, "cells": [3, 3, 3]}
    assert len(problem(mesh=mesh, supports=[{"plane": "x", "at": size[0] / 3}]).body.supports.nodes) == 16


def test_the_initial_state_is_the_rest_shape_with_velocities_on_free_nodes(problem):
    one = problem(initial={"velocity": [0.0, 1.0, -20.0], "factor": 3.0})
    assert np.array_equal(one.start.x, one.body.mesh.points) and one.start.step == 0
    assert np.array_equal(one.start.v[one.body.free], np.tile([0.0, 3.0, -60.0], (len(one.body.free), 1)))
    assert not one.start.v[one.body.supports.nodes].any()


@pytest.mark.parametrize("center", [None, [1.0, -2.0, 0.5]])
def test_a_spin_turns_the_body_about_its_center_in_degrees(problem, center):
    spin = {"axis": [0.0, 3.0, 4.0], "rate": 90.0} | ({"center": center} if center else {})
    one = problem(supports=None, loads=None, initial={"spin": spin, "factor": 2.0})
    arm = one.body.mesh.points - ([0.5, 1.5, 0.5] if center is None else center)
    wanted = np.cross(2.0 * np.pi / 2 * np.array([0.0, 0.6, 0.8]), arm)
    assert one.start.v == pytest.approx(wanted, abs=1e-14 * 20)


def test_a_planar_spin_is_about_z(problem, refused):
    planar = PLANAR | {"supports": None, "loads": None}
    one = problem(**planar | {"initial": {"spin": {"axis": [0, 0, 2.0], "rate": 180.0}}})
    arm = one.body.mesh.points - [0.5, 1.5]
    assert one.start.v == pytest.approx(np.pi * np.stack([-arm[:, 1], arm[:, 0]], axis=1), abs=1e-13)
    assert refused(**planar | {"initial": {"spin": {"axis": [1.0, 0, 0], "rate": 1.0}}}).startswith(
        "initial.spin.axis: "
    )


@pytest.mark.parametrize(
    ("loads", "resultant"),  # the beam is 3 m3 of 1000 kg/m3; its end faces are 1 m2, outward along -y
    [
        ({"gravity": [0.0, 0.0, -9.81]}, [0.0, 0.0, -29430.0]),
        ({"body_force": [0.0, -18.0, -9.0]}, [0.0, -54.0, -27.0]),
        ({"body_force": {"value": [1.0, 0.0, 0.0], "factor": 95.5}}, [286.5, 0.0, 0.0]),
        ({"traction": [{"plane": "y", "at": 0.0, "normal_traction": 1e5}]}, [0.0, -1e5, 0.0]),
        ({"gravity": [1.0, 0.0, 0.0], "body_force": [-1000.0, 0.0, 0.0]}, [0.0, 0.0, 0.0]),
        (None, [0.0, 0.0, 0.0]),
    ],
    ids=["gravity", "body_force", "factor", "traction", "sum", "none"],
)
def test_loads_have_their_resultants(problem, loads, resultant):
    assert problem(loads=loads).body.load.sum(axis=0) == pytest.approx(resultant, abs=1e-9)


def test_a_moving_support_follows_its_motion(problem):
    motion = {"velocity": [0.0, 0.5, 0.0], "spin": {"axis": [0.0, 1.0, 0.0], "rate": 90.0, "center": [0.5, 3, 0.5]}}
    one = problem(supports=[{"plane": "y", "at": 3.0, "motion": motion}], **AT_REST)
    held = one.body.supports.nodes
    center = np.array([0.5, 3.0, 0.5])
    arm = one.body.mesh.points[held] - center
    for frame in frames(one):
        R = rotation_about(np.array([0.0, 1.0, 0.0]), np.pi / 2 * frame.time)
        assert frame.x[held] == pytest.approx(center + arm @ R.T + [0.0, 0.5 * frame.time, 0.0], abs=1e-13)
    assert one.start.v[held] == pytest.approx(np.cross([0, np.pi / 2, 0], arm) + np.array([0, 0.5, 0]), abs=1e-13)


@pytest.mark.parametrize(
    ("sections", "wanted"),
    [
        ({"method": {"law": "lienar"}}, "method.law: 'lienar' is not one of linear, corotational"),
        ({"method": {"rotation": "qr"}}, "method.rotation: 'qr' is not one of polar, gram_schmidt"),
        ({"method": {"stepper": "euler"}}, "method.stepper: 'euler' is not one of backward_euler"),
        ({"method": {"linear_solver": "lu"}}, "method.linear_solver: 'lu' is not one of "),
        ({"mesh": BAR | {"shape": "cube"}}, "mesh.shape: 'cube' is not one of box, rectangle"),
        ({"mesh": BAR | {"split": "delaunay"}}, "mesh"),
        ({"loads": {"gravity": [0.0, -9.81]}}, "loads.gravity: [0.0, -9.81] has 2 components, the mesh has 3"),
        (PLANAR | {"loads": {"gravity": [0, 0, -9.81]}}, "loads.gravity: [0.0, 0.0, -9.81] has 3 components"),
        ({"initial": {"velocity": [1.0, 2.0]}}, "initial.velocity: [1.0, 2.0] has 2 components"),
        ({"supports": [{"plane": "y", "at": 3.1}]}, "supports.0: selects no node; the mesh spans [0.0, 0.0, 0.0] to"),
        ({"supports": [{"above": {"axis": "y", "at": -1.0}}]}, "supports: all 16 nodes are held; no free node is left"),
        ({"supports": [{"nodes": [16]}]}, "supports.0.nodes: 16 is not a node; the mesh has 16, counted from 0"),
        (PLANAR | {"supports": [{"plane": "z", "at": 0.0}]}, "supports.0.plane: 'z' is not an axis of a planar mesh"),
        ({"mesh": {"file": "none.vtu"}}, "mesh: "),
    ],
    ids=lambda value: value[:40] if isinstance(value, str) else "",
)
def test_a_case_that_cannot_be_built_names_its_key_and_the_choices(refused, sections, wanted):
    assert refused(**sections).startswith(wanted)


def test_an_error_of_a_variant_names_the_override(tmp_path):
    case = load_case(write_case(tmp_path, variants={"odd": {"method.law": "plastic"}}))
    with pytest.raises(CaseError, match=r'variants\.odd\."method\.law": \'plastic\' is not one of'):
        build(case.variant("odd"))


def test_a_case_of_several_variants_must_be_resolved_first(tmp_path):
    with pytest.raises(CaseError, match="linear, gram_schmidt, polar"):
        build(load_case(write_case(tmp_path)))
    alone = build(load_case(write_case(tmp_path, variants=None)))
    assert alone.name == "beam/default"


def test_nodes_without_a_cell_are_removed_with_a_note(tmp_path, problem):
    points = np.array([[9.0, 9, 9], [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    meshio.Mesh(points, [("tetra", np.array([[1, 2, 3, 4]]))]).write(tmp_path / "m.vtu")
    one = problem(mesh={"file": "m.vtu"}, supports=[{"nodes": [0]}])
    assert np.array_equal(one.body.mesh.points, points[1:])
    assert [note for note in one.notes if note.startswith("m.vtu: 1 nodes that belong to no tetrahedron were removed")]


def test_a_mesh_of_two_pieces_is_noted(tmp_path, problem):
    tet = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    cells = np.array([[0, 1, 2, 3], [4, 5, 6, 7]])
    meshio.Mesh(np.concatenate([tet, tet + 5]), [("tetra", cells)]).write(tmp_path / "m.vtu")
    assert "the mesh has 2 components" in problem(mesh={"file": "m.vtu"}, supports=[{"nodes": [0]}]).notes


def test_a_rotation_under_the_linear_law_is_noted(problem):
    variants = {"odd": {"method.law": "linear", "method.rotation": "gram_schmidt"}}
    notes = problem("odd", variants=variants).notes
    assert "method.rotation is not used by the linear law" in notes


def test_schedule_and_name_are_those_of_the_case(problem):
    one = problem(schedule={"dt": 0.01, "frame_interval": 0.03, "frames": 7})
    assert (one.name, one.dt, one.steps_per_frame, one.last_frame) == ("beam/polar", 0.01, 3, 7)
    assert [(f.index, f.step) for f in frames(one)] == [(i, 3 * i) for i in range(8)]


@pytest.mark.parametrize("iterations", [1, "converged"])
def test_a_problem_can_be_pickled_before_and_after_it_was_solved(problem, iterations):
    """As tasks of dask need it."""
    fresh = problem(method={"iterations": iterations})
    sent = pickle.dumps(fresh)
    whole = list(islice(frames(fresh), 3))
    for used in (pickle.loads(sent), pickle.loads(pickle.dumps(fresh))):
        assert all(np.array_equal(a.x, b.x) for a, b in zip(whole, islice(frames(used), 3), strict=True))
