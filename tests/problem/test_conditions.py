"""Boundary and initial conditions: moving supports, spins, tractions against closed forms, selections and errors."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.errors import CaseError
from pipeline.mesh.surface import find_boundary_faces, outward_areas
from pipeline.run.frame_iterator import frames
from tests.bodies import PLANAR, build_problem, list_states

STEPPERS = {
    "backward_euler": {"stepper": "backward_euler"},
    "converged": {"stepper": "backward_euler", "iterations": "converged"},
    "bdf2": {"stepper": "bdf2"},
    "symplectic_euler": {"stepper": "symplectic_euler"},
}
STEPPER = pytest.mark.parametrize("method", STEPPERS.values(), ids=STEPPERS)
UNLOADED = {"supports": None, "loads": None, "initial": None}
HELD = {"plane": "y", "at": 3.0}
MOTIONS = {
    "translation": {"velocity": [0.3, -0.2, 0.1]},
    "rotation": {"spin": {"axis": [0.0, 2.0, 0.0], "rate": 300.0, "center": [0.5, 0.0, 0.5]}},
    "both": {"velocity": [0.0, -1.0, 0.0], "spin": {"axis": [1.0, 1.0, 0.0], "rate": -40.0, "center": [0.0, 1.0, 2.0]}},
}
MOTION = pytest.mark.parametrize("driven", MOTIONS.values(), ids=MOTIONS)


def move_points(driven: dict, X: np.ndarray, t: float) -> np.ndarray:
    """The positions to which a motion of a case takes the points X (k, 3), by scipy."""
    out = X
    if "spin" in driven:
        axis, center = np.array(driven["spin"]["axis"]), np.array(driven["spin"]["center"])
        turned = Rotation.from_rotvec(np.radians(driven["spin"]["rate"]) * t * axis / np.linalg.norm(axis))
        out = center + turned.apply(X - center)
    return out + t * np.array(driven.get("velocity", [0.0, 0.0, 0.0]))


def make_planar(driven: dict) -> dict:
    """The motion in the plane: its x and y components, its spin about z."""
    spin = driven.get("spin")
    return ({"velocity": driven["velocity"][:2]} if "velocity" in driven else {}) | (
        {"spin": {"axis": [0.0, 0.0, -2.0], "rate": spin["rate"], "center": spin["center"][:2]}} if spin else {}
    )


def get_refusal(folder: Path, **sections: object) -> str:
    """The message of the CaseError, after the file's name."""
    with pytest.raises(CaseError) as caught:
        build_problem(folder, **sections)
    name, text = str(caught.value).split(".toml: ", 1)
    assert name.endswith("beam") and "\n" not in text
    return text


# Supports that move


@STEPPER
@MOTION
@pytest.mark.parametrize("d", [2, 3])
def test_a_moving_support_follows_its_motion_exactly_at_every_frame(tmp_path, d, driven, method):
    schedule = {"dt": 1e-3, "steps_per_frame": 7, "frames": 6}
    place = {"plane": "y", "at": 0.0, "motion": driven if d == 3 else make_planar(driven)}
    sections = UNLOADED | {"supports": [HELD, place], "method": method, "schedule": schedule}
    one = build_problem(tmp_path, **(PLANAR | sections if d == 2 else sections))
    X = one.body.mesh.points
    end, still = X[:, 1] == 0.0, X[:, 1] == 3.0
    for frame in frames(one):
        about_z = {"spin": {**driven["spin"], "axis": [0, 0, -1.0]}} if d == 2 and "spin" in driven else {}
        exact = move_points(driven | about_z, np.pad(X[end], [(0, 0), (0, 3 - d)]), frame.index * 7e-3)[:, :d]
        assert np.abs(frame.x[end] - exact).max() < 1e-12
        assert np.array_equal(frame.x[still], X[still])
        assert np.isfinite(frame.x).all()
    free = one.body.free
    assert np.abs(frame.x[free] - X[free]).max() > 1e-3  # and it takes the body with it


@MOTION
def test_a_moving_support_starts_at_its_own_velocity_whatever_the_initial_one(tmp_path, driven):
    place = {"plane": "y", "at": 0.0, "motion": driven}
    initial = {"velocity": [5.0, 0.0, 0.0], "factor": 3.0}
    one = build_problem(tmp_path, **UNLOADED | {"supports": [HELD, place], "initial": initial})
    X, v = one.body.mesh.points, one.start.v
    end, still = X[:, 1] == 0.0, X[:, 1] == 3.0
    h = 1e-5  # central differences err by h^2 omega^3, 1e-8 here
    assert v[end] == pytest.approx(
        (move_points(driven, X[end], h) - move_points(driven, X[end], -h)) / (2 * h), abs=1e-7
    )
    assert not v[still].any()
    assert np.array_equal(v[~end & ~still], np.tile([15.0, 0, 0], ((~end & ~still).sum(), 1)))


@STEPPER
def test_a_body_whose_supports_all_move_alike_moves_as_one(tmp_path, method):
    """Thrown at the velocity of its support it does not deform at all."""
    drive = {"velocity": [0.3, -0.2, 0.1]}
    sections = {"supports": [HELD | {"motion": drive}], "initial": drive, "method": method}
    one = build_problem(tmp_path, **UNLOADED | sections | {"schedule": {"dt": 2e-3, "frames": 50}})
    for frame in frames(one):
        wanted = one.body.mesh.points + frame.time * np.array(drive["velocity"])
        assert np.abs(frame.x - wanted).max() < 1e-11  # rounding of forces between points that are off by 1e-16


def test_a_beam_whose_ends_turn_slowly_turns_as_a_whole(tmp_path):
    """Both ends turn slowly about the beam's axis: at the end the whole beam has turned."""
    spin = {"spin": {"axis": [0.0, 1.0, 0.0], "rate": 90.0, "center": [0.5, 0.0, 0.5]}}
    supports = [{"plane": "y", "at": y, "motion": spin} for y in (0.0, 3.0)]
    one = build_problem(tmp_path, **UNLOADED | {"supports": supports, "schedule": {"dt": 0.01, "frames": 100}})
    *_, last = frames(one)
    turned = move_points(spin, one.body.mesh.points, 1.0)
    # 1.6 rad/s swell it by rho omega^2 r^2/E = 1e-4, and one solve turns by .016 rad a step: J = 1 + 2.5e-4
    assert np.abs(last.x - turned).max() < 1e-3


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_node_cannot_follow_two_supports_of_which_one_moves(tmp_path, order):
    two = [HELD, {"plane": "x", "at": 0.0, "motion": {"velocity": [1.0, 0.0, 0.0]}}]
    message = get_refusal(tmp_path, **UNLOADED | {"supports": [two[i] for i in order]})
    assert message.startswith("supports.1: node ") and message.endswith(" is already held by supports.0")
    both = [s | {"motion": {"velocity": [1.0, 0.0, 0.0]}} for s in two]
    assert get_refusal(tmp_path, **UNLOADED | {"supports": both}).startswith("supports.1: node ")
    resting = [HELD, {"plane": "x", "at": 0.0}]
    assert (
        len(build_problem(tmp_path, **UNLOADED | {"supports": resting}).body.supports.nodes) == 2 + 8
    )  # 2 of them in both


@pytest.mark.parametrize(
    ("driven", "message"),
    [
        ({"velocity": [1.0, 2.0]}, "supports.0.motion.velocity: [1.0, 2.0] has 2 components, the mesh has 3 dim"),
        (
            {"spin": {"axis": [0, 1.0, 0], "rate": 1.0, "center": [0.0, 1.0]}},
            "supports.0.motion.spin.center: [0.0, 1.0] has 2 components, the mesh has 3",
        ),
        ({}, "supports.0.motion: none of velocity, spin and displacement is given"),
        ({"spin": {"axis": [0.0, 0.0, 0.0], "rate": 1.0}}, "supports.0.motion.spin.axis: "),
    ],
    ids=["velocity", "center", "nothing", "axis"],
)
def test_an_impossible_motion_is_refused(tmp_path, driven, message):
    assert get_refusal(tmp_path, supports=[HELD | {"motion": driven}]).startswith(message)


def test_a_planar_support_turns_about_z_only(tmp_path):
    place = HELD | {"motion": {"spin": {"axis": [0.0, 1.0, 0.0], "rate": 1.0}}}
    message = get_refusal(tmp_path, **PLANAR | {"supports": [place]})
    assert message.startswith("supports.0.motion.spin.axis: [0.0, 1.0, 0.0] is not along z; the mesh is planar")


# Initial spin


@pytest.mark.parametrize("method", ["linear", "polar"])
def test_the_factor_scales_velocity_and_spin_and_nothing_else(tmp_path, method):
    initial = {"velocity": [1.0, 2.0, 3.0], "spin": {"axis": [1.0, 0.0, 2.0], "rate": 50.0}}
    loads = {"gravity": [0.0, 0.0, -9.81]}
    one, three = (
        build_problem(tmp_path, method, supports=None, loads=loads, initial=initial | {"factor": f}) for f in (1.0, 3.0)
    )
    assert three.start.v == pytest.approx(3 * one.start.v, rel=1e-15)
    assert np.array_equal(three.body.load, one.body.load) and np.array_equal(three.start.x, one.start.x)


@pytest.mark.parametrize("d", [2, 3])
def test_a_spin_about_the_center_of_mass_has_no_linear_momentum(tmp_path, d):
    axis = [0.0, 0.0, 1.0] if d == 2 else [1.0, -2.0, 0.5]
    initial = {"velocity": [1.0, 2.0, 3.0][:d], "spin": {"axis": axis, "rate": 100.0}}
    sections = UNLOADED | {"initial": initial}
    one = build_problem(tmp_path, **(PLANAR | sections if d == 2 else sections))
    m, v = one.body.lumped_mass, one.start.v
    assert m @ v / m.sum() == pytest.approx([1.0, 2.0, 3.0][:d], abs=1e-12)
    arm = np.pad(one.start.x - [0.5, 1.5, 0.5][:d], [(0, 0), (0, 3 - d)])
    omega = np.radians(100.0) * np.array(axis) / np.linalg.norm(axis)
    assert np.pad(v - [1.0, 2.0, 3.0][:d], [(0, 0), (0, 3 - d)]) == pytest.approx(np.cross(omega, arm), abs=1e-12)


# Tractions, E = 1e7, nu = .3


def run_to_balance(folder: Path, variant: str, traction: list, mesh: dict) -> tuple:
    """A free body under loads in balance, its rest X and its end x about the center.

    dt = .1 s is ten radians of its slowest mode, of which backward Euler leaves a tenth a step.
    """
    one = build_problem(folder, variant, **UNLOADED | {"loads": {"traction": traction}, "mesh": mesh})
    X = one.body.mesh.points
    end = list_states(one.body, 0.1, 30, np.zeros_like(X), iterations="converged")[-1].x
    return one, X - X.mean(axis=0), end - end.mean(axis=0)


# of the strain: Newton stops at 1e-9 of forces of E / 100, and a turn, which t alone holds, is the softest motion
CLOSE = 1e-6
CUBE = {"shape": "box", "size": [2.0, 3.0, 1.0], "cells": [2, 3, 1]}
# a dead pressure on a free body that can turn is not stable: it turns over, to be pulled
PULLS = [("linear", 1e5), ("linear", -1e5), ("polar", 1e5)]
SHEET = {"shape": "rectangle", "size": [2.0, 3.0], "cells": [2, 3]}


@pytest.mark.parametrize("split", ["kuhn", "alternating"])
@pytest.mark.parametrize(("variant", "t"), PULLS)
def test_a_block_pulled_at_two_faces_stretches_by_hookes_law(tmp_path, t, variant, split):
    ends = [{"plane": "y", "at": y, "normal_traction": t} for y in (0.0, 3.0)]
    _, X, x = run_to_balance(tmp_path, variant, ends, CUBE | {"split": split})
    e = t / 1e7
    assert np.abs(x - X * [1 - 0.3 * e, 1 + e, 1 - 0.3 * e]).max() < CLOSE * abs(e)
    _, X, x = run_to_balance(tmp_path, variant, ends, SHEET | {"split": split})
    plane = np.array([-0.3 * 1.3 * e, (1 - 0.3**2) * e])  # plane strain
    assert np.abs(x - X * (1 + plane)).max() < CLOSE * abs(e)


@pytest.mark.parametrize(("variant", "t"), PULLS)
def test_a_traction_all_round_has_no_resultant_and_swells_the_block_evenly(tmp_path, variant, t):
    whole = [{"box": [[0.0, 0.0, 0.0], [2.0, 3.0, 1.0]], "normal_traction": t}]
    one, X, x = run_to_balance(tmp_path, variant, whole, CUBE)
    load = one.body.load
    assert np.abs(load.sum(axis=0)).max() < 1e-14 * np.abs(load).sum()
    assert np.abs(np.cross(one.start.x, load).sum(axis=0)).max() < 1e-14 * 3 * np.abs(load).sum()
    assert np.abs(x - X * (1 + t * (1 - 2 * 0.3) / 1e7)).max() < CLOSE * abs(t) / 1e7
    sheet = [{"box": [[0.0, 0.0], [2.0, 3.0]], "normal_traction": t}]
    one, X, x = run_to_balance(tmp_path, variant, sheet, SHEET)
    assert np.abs(one.body.load.sum(axis=0)).max() < 1e-14 * np.abs(one.body.load).sum()
    assert np.abs(x - X * (1 + t * (1 - 2 * 0.3) * 1.3 / 1e7)).max() < CLOSE * abs(t) / 1e7


@pytest.mark.parametrize(("face", "normal"), [(("x", 0.0), 0), (("x", 2.0), 0), (("y", 3.0), 1), (("z", 1.0), 2)])
def test_a_traction_pulls_outward_with_its_area_on_its_own_nodes_only(tmp_path, face, normal):
    traction = [{"plane": face[0], "at": face[1], "normal_traction": 4.0}]
    one = build_problem(tmp_path, **UNLOADED | {"loads": {"traction": traction}, "mesh": CUBE})
    size = np.array([2.0, 3.0, 1.0])
    outward = np.eye(3)[normal] * (1 if face[1] else -1)
    area = size.prod() / size[normal]
    assert one.body.load.sum(axis=0) == pytest.approx(4.0 * area * outward, abs=1e-13)
    assert not one.body.load[one.body.mesh.points[:, normal] != face[1]].any()


def test_a_traction_is_on_the_faces_of_the_boundary_whose_corners_are_all_selected(tmp_path):
    mesh = {"shape": "box", "size": [2.0, 3.0, 1.0], "cells": [2, 3, 2]}
    inside = {"plane": "y", "at": 1.0, "normal_traction": 1.0}  # a section: its faces are all inside
    assert get_refusal(tmp_path, loads={"traction": [inside]}, mesh=mesh) == (
        "loads.traction.0: its nodes are not the corners of any boundary face"
    )
    half = {"above": {"axis": "y", "at": 1.5}, "normal_traction": 5.0}
    one = build_problem(tmp_path, **UNLOADED | {"loads": {"traction": [half]}, "mesh": mesh})
    faces, _ = find_boundary_faces(one.body.mesh)
    X = one.body.mesh.points
    chosen = faces[(X[faces][:, :, 1] > 1.5).all(axis=1)]
    assert len(chosen) == 8 + 4 * 4  # the end, and the row of squares beside it on four sides, in triangles
    assert one.body.load.sum(axis=0) == pytest.approx(5.0 * outward_areas(X, chosen).sum(axis=0), abs=1e-13)
    twice = build_problem(tmp_path, **UNLOADED | {"loads": {"traction": [half, half]}, "mesh": mesh})
    assert np.array_equal(twice.body.load, 2 * one.body.load)


def test_a_traction_is_a_dead_load_on_the_rest_surface(tmp_path):
    """It does not turn with the body: on a free block that has turned it acts as at rest."""
    ends = [{"plane": "y", "at": y, "normal_traction": 1e3} for y in (0.0, 3.0)]
    spin = {"spin": {"axis": [0.0, 0.0, 1.0], "rate": 90.0}}
    one = build_problem(tmp_path, **UNLOADED | {"loads": {"traction": ends}, "initial": spin})
    before = one.body.load.copy()
    last = list(frames(one))[-1]
    assert np.array_equal(one.body.load, before)
    potential = -(before * (last.x - one.body.mesh.points)).sum()
    assert last.known["potential_energy"] == pytest.approx(potential, rel=1e-14)


# Selections


@pytest.mark.parametrize(
    ("selector", "count"),
    [
        ({"plane": "x", "at": 0.5}, 7),
        ({"box": [[0.0, 0.0], [0.5, 1.0]]}, 6),
        ({"sphere": {"center": [0.0, 0.0], "radius": 0.5}}, 3),
        ({"below": {"axis": "y", "at": 0.5}}, 3),
        ({"above": {"axis": "x", "at": 0.5}}, 7),
        ({"nodes": [3, 3, 20]}, 2),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_a_selector_holds_the_nodes_that_it_describes_in_the_plane(tmp_path, selector, count):
    assert len(build_problem(tmp_path, **PLANAR | {"supports": [selector]}).body.supports.nodes) == count


WRONG = {
    "empty plane": (
        {},
        {"plane": "y", "at": 3.1},
        ": selects no node; the mesh spans [0.0, 0.0, 0.0] to [1.0, 3.0, 1.0]",
    ),
    "empty box": ({}, {"box": [[0.1, 0.1, 0.1], [0.2, 0.2, 0.2]]}, ": selects no node; the mesh spans"),
    "empty sphere": ({}, {"sphere": {"center": [9.0, 0.0, 0.0], "radius": 1.0}}, ": selects no node; the mesh spans"),
    "empty below": ({}, {"below": {"axis": "y", "at": 0.0}}, ": selects no node; the mesh spans"),
    "empty above": (PLANAR, {"above": {"axis": "x", "at": 1.0}}, ": selects no node; the mesh spans [0.0, 0.0] to"),
    "no such node": ({}, {"nodes": [0, 16]}, ".nodes: 16 is not a node; the mesh has 16, counted from 0"),
    "short box": (
        {},
        {"box": [[0.0, 0.0], [1.0, 1.0]]},
        ".box: [0.0, 0.0] has 2 components, the mesh has 3 dimensions",
    ),
    "long box": (PLANAR, {"box": [[0.0, 0, 0], [1.0, 1, 1]]}, ".box: [0.0, 0.0, 0.0] has 3 components, the mesh has 2"),
    "short centre": ({}, {"sphere": {"center": [0.0, 0.0], "radius": 1.0}}, ".sphere.center: [0.0, 0.0] has 2 compon"),
    "plane z": (PLANAR, {"plane": "z", "at": 0.0}, ".plane: 'z' is not an axis of a planar mesh"),
    "below z": (PLANAR, {"below": {"axis": "z", "at": 1.0}}, ".below: 'z' is not an axis of a planar mesh"),
    "above z": (PLANAR, {"above": {"axis": "z", "at": -1.0}}, ".above: 'z' is not an axis of a planar mesh"),
}


@pytest.mark.parametrize(("sections", "selector", "wanted"), WRONG.values(), ids=WRONG)
def test_an_empty_or_impossible_selection_is_refused_for_supports_and_tractions_alike(
    tmp_path, sections, selector, wanted
):
    assert get_refusal(tmp_path, **sections | {"supports": [selector]}).startswith(f"supports.0{wanted}")
    loads = {"traction": [{**selector, "normal_traction": 1.0}]}
    assert get_refusal(tmp_path, **sections | {"loads": loads}).startswith(f"loads.traction.0{wanted}")
