"""Materials of regions in cases: selection, order, errors, layers in series and parallel, weight, spin."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.case.model import validate_case
from pipeline.errors import CaseError
from pipeline.problem.check import check_problem
from pipeline.problem.materials import number_materials
from pipeline.problem.problem import build, build_mesh
from pipeline.run.frame_iterator import frames
from pipeline.run.measures import measure

SOFT = {"youngs_modulus": 1e6, "poisson_ratio": 0.0, "density": 1000.0}
STIFF = {"youngs_modulus": 9e6, "poisson_ratio": 0.0, "density": 3000.0}
ORDERS = pytest.mark.parametrize("order", [1, 2])
DIMENSIONS = pytest.mark.parametrize("d", [2, 3])


def make_case(d=3, order=1, materials=(), **sections):
    mesh = {"shape": "box", "size": [4.0, 1.0, 1.0], "cells": [4, 1, 1], "order": order}
    if d == 2:
        mesh |= {"shape": "rectangle", "size": [4.0, 1.0], "cells": [4, 1]}
    document = {
        "name": "regions", "mesh": mesh, "material": SOFT, "materials": list(materials),
        "supports": [{"plane": "x", "at": 0.0}], "schedule": {"dt": 0.01, "frames": 1},
        "method": {"law": "linear"}, **sections,
    }  # fmt: skip
    return validate_case(document, Path("regions.toml"))


def solve(problem):
    """The positions at rest under the loads, by K u = f on the free nodes."""
    body, pattern = problem.body, problem.body.free_pattern
    K = pattern.matrix(body.linearize(body.mesh.points)[1][: pattern.blocks]).toarray()
    u = np.zeros_like(body.mesh.points)
    u[body.free] = np.linalg.solve(K, body.load[body.free].ravel()).reshape(len(body.free), -1)
    return u


@ORDERS
@DIMENSIONS
def test_layers_in_series_add_their_compliances(d, order):
    region = STIFF | {"above": {"axis": "x", "at": 2.0}}
    traction = [{"plane": "x", "at": 4.0, "normal_traction": 1e3}]
    u = solve(problem := build(make_case(d, order, [region], loads={"traction": traction})))
    X = problem.body.mesh.points[:, 0]
    exact = 1e3 * (np.minimum(X, 2.0) / 1e6 + np.maximum(X - 2.0, 0.0) / 9e6)
    assert u[:, 0] == pytest.approx(exact, rel=1e-9, abs=1e-14)


@ORDERS
@DIMENSIONS
def test_layers_in_parallel_share_the_load_by_their_moduli(d, order):
    """A bar of two layers along y, both ends kept plane by equal motion: F = (E1 + E2) / 2 A strain."""
    size, cells = ([4.0, 2.0, 1.0], [4, 2, 1]) if d == 3 else ([4.0, 2.0], [4, 2])
    mesh = {"shape": "box" if d == 3 else "rectangle", "size": size, "cells": cells, "order": order}
    case = make_case(d, order, [STIFF | {"above": {"axis": "y", "at": 1.0}}], mesh=mesh)
    body = build(case).body
    stretch = np.zeros((d, d))
    stretch[0, 0] = 1e-3
    f = body.force(body.mesh.points @ (np.eye(d) + stretch))
    end = body.mesh.points[:, 0] == 4.0
    assert -f[end, 0].sum() == pytest.approx((1e6 + 9e6) / 2 * 2.0 * 1e-3, rel=1e-12)


@ORDERS
@DIMENSIONS
def test_weight_and_mass_follow_the_densities(d, order):
    gravity = [0.0, -10.0, 0.0][:d]
    case = make_case(d, order, [STIFF | {"above": {"axis": "x", "at": 3.0}}], loads={"gravity": gravity})
    problem = build(case)
    assert problem.body.lumped_mass.sum() == pytest.approx(3 * 1000.0 + 3000.0, rel=1e-12)
    assert problem.body.load.sum(axis=0) == pytest.approx(np.array(gravity) * 6000.0, rel=1e-12, abs=1e-9)
    torque = (problem.body.mesh.points[:, 0] * problem.body.load[:, 1]).sum()  # about the origin
    assert torque == pytest.approx(-10.0 * (3000.0 * 1.5 + 3000.0 * 3.5), rel=1e-12)


@ORDERS
def test_a_body_of_two_densities_spins_about_its_center_of_mass(order):
    region = STIFF | {"above": {"axis": "x", "at": 3.0}}
    case = make_case(3, order, [region], supports=[], initial={"spin": {"axis": [0, 0, 1], "rate": 90.0}})
    problem = build(case)
    assert problem.body.momentum(problem.start.v).sum(axis=0) == pytest.approx(0.0, abs=1e-9)
    center = (3000.0 * 1.5 + 3000.0 * 3.5) / 6000.0
    at = np.abs(problem.body.mesh.points[:, 0] - 4.0) < 1e-12
    assert problem.start.v[at, 1] == pytest.approx(np.pi / 2 * (4.0 - center), rel=1e-12)


def test_later_regions_replace_earlier_ones():
    regions = [STIFF | {"box": [[0, 0, 0], [3, 1, 1]]}, SOFT | {"density": 5.0, "above": {"axis": "x", "at": 2.0}}]
    case = make_case(materials=regions)
    mesh = build_mesh(case)
    numbers = number_materials(case, mesh)
    assert numbers.tolist() == np.where(mesh.centers[:, 0] > 2, 2, 1).tolist()
    assert build(case).body.material.density.tolist() == np.where(mesh.centers[:, 0] > 2, 5.0, 3000.0).tolist()


def test_cells_are_those_before_refinement():
    mesh = {"shape": "box", "size": [4.0, 1.0, 1.0], "cells": [4, 1, 1]}
    case = make_case(materials=[STIFF | {"cells": [0, 5]}], mesh=mesh)
    fine = make_case(materials=[STIFF | {"cells": [0, 5]}], mesh=mesh | {"refine": 1})
    volumes = [build_mesh(c).rest_volumes[number_materials(c, build_mesh(c)) == 1].sum() for c in (case, fine)]
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-13)
    assert (number_materials(fine, build_mesh(fine)) == 1).sum() == 16


def test_values_in_which_regions_agree_stay_numbers():
    body = build(make_case(materials=[SOFT | {"density": 7.0, "cells": [0]}])).body
    assert isinstance(body.material.mu, float) and isinstance(body.material.density, np.ndarray)
    same = build(make_case(materials=[SOFT | {"cells": [0]}])).body
    assert isinstance(same.material.density, float)


def test_notes_and_check_name_the_regions():
    problem = build(make_case(materials=[STIFF | {"above": {"axis": "x", "at": 3.0}}]))
    assert "materials.0: 6 cells, 1 m3, youngs_modulus = 9e+06, poisson_ratio = 0, density = 3000" in problem.notes
    assert any(note.startswith("material: 18 cells, 3 m3") for note in problem.notes)
    check = check_problem(problem)
    assert check.mass == pytest.approx(6000.0) and check.wave_speed == pytest.approx(np.sqrt(9e6 / 3000.0))


@pytest.mark.parametrize(
    ("regions", "message"),
    [
        ([STIFF], r"materials\.0: no selector; give one of group, field, box, sphere, below, above, cells"),
        ([STIFF | {"cells": [0], "below": {"axis": "x", "at": 1}}], r"materials\.0: below and cells cannot be"),
        ([STIFF | {"cells": [24]}], r"materials\.0\.cells: 24 is not a cell; the mesh has 24, counted from 0"),
        ([STIFF | {"above": {"axis": "x", "at": 9}}], r"materials\.0: selects no cell; the centers of cells span"),
        ([STIFF | {"cells": [0]}, SOFT | {"above": {"axis": "x", "at": 0}}], r"materials\.0: all of its cells belong"),
        ([{"cells": [0], "density": 1.0}], r"materials\.0\.youngs_modulus: missing"),
    ],
)
def test_wrong_regions_are_refused(regions, message):
    with pytest.raises(CaseError, match=message):
        build(make_case(materials=regions))


@ORDERS
@DIMENSIONS
def test_a_stiff_inclusion_hardly_strains(d, order):
    """In the limit of a rigid inclusion the strain in it vanishes as the ratio of the moduli."""
    traction = [{"plane": "x", "at": 4.0, "normal_traction": 1e3}]
    strains = []
    for ratio in (1e3, 1e5):
        region = SOFT | {"youngs_modulus": 1e6 * ratio, "box": [[1.0, 0, 0][:d], [3.0, 1, 1][:d]]}
        u = solve(problem := build(make_case(d, order, [region], loads={"traction": traction})))
        X = problem.body.mesh.points
        ends = [u[np.abs(X[:, 0] - x) < 1e-12, 0].mean() for x in (1.0, 3.0, 4.0)]
        strains.append(ends[1] - ends[0])
        assert ends[2] == pytest.approx(1e3 / 1e6 * 2.0 + 2 * 1e3 / (1e6 * ratio), rel=1e-9)
    assert strains[0] == pytest.approx(100 * strains[1], rel=1e-4)


def test_the_center_of_mass_of_a_run_is_that_of_its_densities():
    frame = next(iter(frames(build(make_case(materials=[STIFF | {"above": {"axis": "x", "at": 3.0}}])))))
    center = (3000.0 * 1.5 + 3000.0 * 3.5) / 6000.0
    assert measure(frame)["center_of_mass"] == pytest.approx([center, 0.5, 0.5], rel=1e-12)
