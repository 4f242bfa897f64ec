"""The bodies of cases/meshes: their properties, the program that makes them, and the seeds' numbers on them."""

from pathlib import Path

import numpy as np
import pytest

from pipeline import build, frames, load_case
from pipeline.mesh.files import read_mesh
from pipeline.mesh.simplex import label_components, measure_quality
from pipeline.mesh.surface import find_boundary_faces

MESHES = Path(__file__).resolve().parents[2] / "cases" / "meshes"
COUNTS = {"mushroom": (219, 656), "mushroom_sliver": (219, 656), "armadillo": (285, 787)}  # thesis, 7.1.3 and 7.1.4

# (case, variant): largest volume ratio of a tet over the run, and its source: "measured" on these meshes with another
# program of the same method before this one, or "here", by this program, to guard against change; and the published
# number.
LARGEST = {
    ("mushroom_as_printed", "linear"): ("1.026", "measured; published 2.25"),
    ("mushroom_as_printed", "gram_schmidt"): ("1.0256", "measured; published 'infinitesimal'"),
    ("mushroom_as_printed", "polar"): ("1.0255", "here; published 'infinitesimal'"),
    ("mushroom", "linear"): ("2.25", "measured; published 2.25, to which the factor 8.21 was fitted"),
    ("mushroom", "gram_schmidt"): ("1.166", "measured; published 'infinitesimal'"),
    ("mushroom", "polar"): ("1.162", "measured; published 'infinitesimal'"),
    ("armadillo_as_printed", "linear"): ("1.005", "measured; published 6.335"),
    ("armadillo_as_printed", "gram_schmidt"): ("1.005", "measured; published 'small'"),
    ("armadillo_as_printed", "polar"): ("1.005", "measured; published 'small'"),
    # another program gave 6.335 with a factor that was then rounded to 95.5
    ("armadillo", "linear"): ("6.332", "here; published 6.335, to which the factor 95.5 was fitted"),
    ("armadillo", "gram_schmidt"): ("1.30", "measured; published 'small'"),
    ("armadillo", "polar"): ("1.25", "measured; published 'small'"),
}
# Newton to convergence in every step: several seconds each
LARGEST_CONVERGED = {
    "mushroom_as_printed": ("1.0255", "here"),
    "mushroom": ("1.156", "here"),
    "armadillo_as_printed": ("1.005", "here"),
    "armadillo": ("1.2528", "here"),
}


def read_committed(name):
    return read_mesh(MESHES / f"{name}.vtu")


def is_rounded_to(value: float, text: str) -> bool:
    return abs(value - float(text)) <= 0.51 * 10.0 ** -len(text.split(".")[1])  # half a unit of the last digit


# The meshes


@pytest.mark.parametrize("name", COUNTS)
def test_a_mesh_has_the_published_counts_and_is_one_sound_body(name):
    mesh = read_mesh(MESHES / f"{name}.vtu")
    assert (len(mesh.points), len(mesh.cells)) == COUNTS[name] and mesh.notes == ()
    assert label_components(mesh)[0] == 1 and (mesh.rest_volumes > 0).all()
    faces, _ = find_boundary_faces(mesh)
    edges, shared = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1), axis=0, return_counts=True)
    assert (shared == 2).all()  # the surface is closed
    assert len(np.unique(faces)) - len(edges) + len(faces) == 2  # and has no handles


@pytest.mark.parametrize(("name", "worst"), [("mushroom", 0.61), ("armadillo", 0.53)])
def test_a_mesh_has_good_cells(name, worst):
    q = measure_quality(read_committed(name))
    assert q.min() > worst > 0.05  # the requirement is 0.05
    assert np.median(q) > 0.87 > 0.4


def test_the_sliver_differs_from_the_mushroom_by_one_node_inside():
    sliver, mushroom = read_committed("mushroom_sliver"), read_committed("mushroom")
    assert np.array_equal(sliver.cells, mushroom.cells)
    moved = np.flatnonzero((sliver.points != mushroom.points).any(axis=1))
    assert moved.size == 1 and moved[0] not in find_boundary_faces(mushroom)[0]
    q = np.sort(measure_quality(sliver))
    assert q[0] < 0.01 < 0.1 < q[1]


@pytest.mark.parametrize("name", COUNTS)
def test_a_mesh_is_written_in_the_file_and_not_appended(name):
    text = (MESHES / f"{name}.vtu").read_text(encoding="utf-8")  # VTK's raw appended data would not decode
    assert "AppendedData" not in text and 'type="Float64" Name="Points"' in text


def test_the_bodies_stand_upright_and_the_scale_gives_the_published_largest_tet(cases_folder):
    mushroom, armadillo = read_committed("mushroom"), read_committed("armadillo")
    for mesh in (mushroom, armadillo):
        assert np.ptp(mesh.points, axis=0).argmax() == 2
    assert (mushroom.points[:, 2] < -10).sum() == 20
    snout, tail = armadillo.points[:, 1].argmin(), armadillo.points[:, 1].argmax()
    assert armadillo.points[snout, 2] > 5 and armadillo.points[tail, 2] < 0  # it faces -y
    problem = build(load_case(cases_folder / "armadillo.toml").variant("linear"))
    rest = problem.body.mesh
    assert rest.rest_volumes.max() == pytest.approx(5446, rel=1e-3)  # published
    assert np.ptp(rest.points[:, 2]) == pytest.approx(296, abs=0.5)
    feet = rest.points[problem.body.supports.nodes]
    assert len(feet) == 33 and (feet[:, 0] < 0).any() and (feet[:, 0] > 0).any()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mushroom", "armadillo"])
def test_the_program_still_makes_the_counts(name):
    from tools.meshing.build import SHAPES, make_mesh

    mesh = make_mesh(SHAPES[name]())  # raises ValueError if counts or surface are wrong
    assert (len(mesh.points), len(mesh.cells)) == COUNTS[name]
    # with the versions in constraints.txt it is the committed mesh to the last bit; others may round another way
    assert measure_quality(mesh).min() > 0.3 and np.median(measure_quality(mesh)) > 0.8


def test_the_program_still_makes_the_sliver():
    from tools.meshing.build import add_sliver

    assert add_sliver(read_committed("mushroom")).points == pytest.approx(
        read_committed("mushroom_sliver").points, abs=1e-9
    )


# The motions


@pytest.mark.parametrize(("case", "variant"), LARGEST)
def test_largest_growth_of_a_tet(ratios, case, variant):
    expected, _ = LARGEST[case, variant]
    J = ratios(case, variant)
    assert len(J) == 101 and np.all(J[0] == 1.0)
    assert is_rounded_to(J.max(), expected), J.max()


@pytest.mark.slow
@pytest.mark.parametrize("case", LARGEST_CONVERGED)
def test_largest_growth_of_a_tet_with_converged_steps(ratios, case):
    J = ratios(case, "converged")
    assert is_rounded_to(J.max(), LARGEST_CONVERGED[case][0]), J.max()
    assert J.max() <= ratios(case, "polar").max() + 1e-4  # the spurious growth of one solve


@pytest.mark.parametrize("case", ["mushroom", "armadillo"])
def test_no_tet_inverts_and_the_linear_law_swells_most(ratios, case):
    linear, *others = (ratios(case, name) for name in ("linear", "gram_schmidt", "polar"))
    assert min(J.min() for J in (linear, *others)) > 0.1
    assert linear.max() - 1 > 5 * max(J.max() - 1 for J in others)


def test_the_part_of_the_armadillo_that_is_not_reproduced(ratios, cases_folder):
    """Published: the tet of 5446 m3 grows to 3.45e4 m3 at step 26."""
    J = ratios("armadillo", "linear")
    step, cell = np.unravel_index(J.argmax(), J.shape)
    rest = build(load_case(cases_folder / "armadillo.toml").variant("linear")).body.mesh.rest_volumes
    assert step == 95 and cell != rest.argmax()
    assert (J * rest).max() == pytest.approx(31670, rel=1e-3)  # here


@pytest.mark.parametrize("variant", ["linear", "gram_schmidt", "polar", "converged"])
def test_the_mushroom_with_a_sliver_moves_as_the_one_without(cases_folder, variant):
    """A cell of quality 3e-4 only disturbs its neighbors; its own node is another point of the body."""
    ends = []
    for name in ("mushroom", "mushroom_sliver"):
        overrides = {"mesh.file": f"meshes/{name}.vtu", "schedule.frames": 14}
        *_, last = frames(build(load_case(cases_folder / "mushroom.toml", overrides=overrides).variant(variant)))
        ends.append(last)
    same = (ends[0].mesh.points == ends[1].mesh.points).all(axis=1)
    moved = np.abs(ends[0].x - ends[0].mesh.points).max()  # 14 of a height of 27
    assert np.abs(ends[1].x - ends[0].x)[same].max() < 2e-3 * moved  # measured 6e-4 to 8e-4
