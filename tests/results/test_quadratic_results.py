"""Results of order 2: quadratic cells in all files, exact volumes, the same numbers from our analysis, comparisons."""

import numpy as np
import pytest
import pyvista
import xarray
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOHDF import vtkHDFReader

from pipeline import analyze, build, read_series
from pipeline.case import load_case
from pipeline.cli import main
from pipeline.mesh.integration import integrate_cells
from pipeline.mesh.quadratic import QuadraticMesh, make_quadratic_mesh
from pipeline.mesh.quadrature import find_mass_quadrature
from pipeline.results.case_run import run_case
from pipeline.series.xarray_plugin import SeriesBackend
from tests.bodies import PLANAR, case_document, skip_figures, write_case

CELLS = {"3D": ({}, 24, "tetra10", 18), "2D": (PLANAR, 22, "triangle6", 24)}
FAST = {"variants": {"polar": {}}, "schedule": {"dt": 0.02, "frames": 5}}


@pytest.fixture(autouse=True)
def _no_figures(monkeypatch):
    skip_figures(monkeypatch)


def raise_order(sections: dict[str, object]) -> dict[str, object]:
    mesh = dict(case_document(**sections)["mesh"])
    return sections | {"mesh": mesh | {"order": 2}}


def run(folder, sections, **more):
    return run_case(load_case(write_case(folder, **(FAST | raise_order(sections) | more))), folder / "out", movie=False)


def integrate_volumes(mesh: QuadraticMesh, x: np.ndarray) -> np.ndarray:
    """int det F dV of every cell, by a rule of a much higher degree than needed, of a mesh of our own."""
    rule = find_mass_quadrature(mesh.dimension, is_straight=False)
    return integrate_cells(x, mesh.cells, mesh.kind, rule).weights.sum(axis=1)


@pytest.mark.parametrize("scene", CELLS)
def test_files_have_quadratic_cells_with_exact_volumes(tmp_path, scene):
    import meshio

    sections, number, name, count = CELLS[scene]
    folder = run(tmp_path, sections).variants[0].folder
    grid = pyvista.read(folder / "frames" / "frame_000005.vtu")
    assert (grid.celltypes == number).all() and grid.n_cells == count
    (block,) = meshio.read(folder / "frames" / "frame_000005.vtu").cells
    assert block.type == name and np.array_equal(block.data.ravel(), grid.cell_connectivity)
    d = 3 if number == 24 else 2
    mesh = make_quadratic_mesh(grid.point_data["rest_position"][:, :d], block.data)
    volumes = integrate_volumes(mesh, np.asarray(grid.points)[:, :d])
    data = grid.cell_data
    assert data["volume"] == pytest.approx(volumes, rel=1e-12)
    assert data["volume_ratio"] == pytest.approx(volumes / mesh.rest_volumes, rel=1e-12)
    assert np.ptp(data["volume_ratio"]) > 1e-3
    F = np.einsum("eki,eqkj->eqij", np.asarray(grid.points)[:, :d][mesh.cells], mesh.integration.gradients)
    J = np.linalg.det(F)
    assert (data["volume_ratio_min"] <= J.min(axis=1)).all() and (data["volume_ratio_max"] >= J.max(axis=1)).all()
    # the extremes include the nodes, where J of a quadratic displacement is largest more often than not
    at_nodes = np.linalg.det(
        np.einsum(
            "eki,eqkj->eqij",
            np.asarray(grid.points)[:, :d][mesh.cells],
            integrate_cells(mesh.points, mesh.cells, mesh.kind, find_nodes(mesh)).gradients,
        )
    )
    assert (data["volume_ratio_max"] >= at_nodes.max(axis=1) - 1e-12).all()
    assert (data["volume_ratio_min"] <= at_nodes.min(axis=1) + 1e-12).all()


def find_nodes(mesh: QuadraticMesh):
    return find_mass_quadrature(mesh.dimension, is_straight=True)._replace(
        points=mesh.kind.nodes, weights=np.ones(len(mesh.kind.nodes))
    )


@pytest.mark.parametrize("scene", CELLS)
def test_vtkhdf_has_the_cells_and_numbers_of_vtu(tmp_path, scene):
    sections, number, _, count = CELLS[scene]
    (tmp_path / "b").mkdir()
    vtu = run(tmp_path, sections).variants[0].folder
    hdf = run(tmp_path / "b", sections, output={"format": "vtkhdf"}).variants[0].folder
    reader = vtkHDFReader()
    reader.SetFileName(str(hdf / "series.vtkhdf"))
    reader.SetStep(5)
    reader.Update()
    grid, other = reader.GetOutputDataObject(0), pyvista.read(vtu / "frames" / "frame_000005.vtu")
    assert grid.GetNumberOfCells() == count and {grid.GetCellType(i) for i in range(count)} == {number}
    assert np.array_equal(vtk_to_numpy(grid.GetPoints().GetData()), other.points)
    assert np.array_equal(vtk_to_numpy(grid.GetCells().GetConnectivityArray()), other.cell_connectivity)
    for field in ("volume_ratio", "volume_ratio_min", "volume_ratio_max", "rotation_angle"):
        assert np.array_equal(vtk_to_numpy(grid.GetCellData().GetArray(field)), other.cell_data[field])


@pytest.mark.parametrize("scene", CELLS)
def test_our_analysis_of_a_run_has_its_numbers_to_the_bit(tmp_path, scene):
    folder = run(tmp_path, CELLS[scene][0]).variants[0].folder
    analyze(folder, tmp_path / "analysis")
    with (
        xarray.open_dataset(folder / "statistics.nc") as own,
        xarray.open_dataset(tmp_path / "analysis" / "statistics.nc") as found,
    ):
        assert {"volume_ratio_min", "volume_ratio_max"} <= set(own.data_vars) == set(found.data_vars)
        for name in own.data_vars:
            assert np.array_equal(own[name].values, found[name].values, equal_nan=True), name


@pytest.mark.parametrize("scene", CELLS)
def test_the_dataset_names_its_quadratic_cells(tmp_path, scene):
    sections, number, _, count = CELLS[scene]
    folder = run(tmp_path, sections).variants[0].folder
    mesh = read_series(folder).mesh
    assert (mesh.cell_array.types == number).all()
    with xarray.open_dataset(folder / "series.pvd", engine=SeriesBackend) as dataset:
        assert dataset.sizes["cell"] == count and dataset.sizes["node"] == len(mesh.points)
        assert (dataset["cell_type"].values == number).all()
        path = tmp_path / "dataset.nc"
        dataset.to_netcdf(path)
    with xarray.open_dataset(path) as again:
        topology = next(v for v in again.variables.values() if v.attrs.get("cf_role") == "mesh_topology")
        assert topology.attrs["topology_dimension"] == mesh.dimension


def test_variants_of_both_orders_are_compared_cell_by_cell(tmp_path):
    variants = {"order_1": {}, "order_2": {"mesh.order": 2}}
    case = load_case(write_case(tmp_path, variants=variants, schedule={"dt": 0.02, "frames": 3}))
    result = run_case(case, tmp_path / "out", movie=False)
    assert not [note for note in result.notes if "left out" in note]
    with xarray.open_dataset(result.folder / "comparison.nc") as joined:
        assert joined["variant"].values.tolist() == ["order_1", "order_2"] and joined["rest_volume"].dims == ("cell",)
        assert joined["volume_ratio"].notnull().all()
        assert joined["volume_ratio_min"].isnull().all(("time", "cell")).values.tolist() == [True, False]
    assert main(["report", str(result.folder)]) == 0


def test_cells_of_another_split_are_not_taken_for_the_same(tmp_path):
    """All cells of both splits have the same volume, and are other cells."""
    mesh = {"shape": "box", "size": [2.0, 4.0, 2.0], "cells": [2, 4, 2]}
    variants = {"kuhn": {}, "alternating": {"mesh.split": "alternating"}}
    case = load_case(
        write_case(
            tmp_path,
            mesh=mesh,
            supports=[{"plane": "y", "at": 4.0}],
            variants=variants,
            **{"schedule": {"dt": 0.02, "frames": 1}},
        )
    )
    result = run_case(case, tmp_path / "out", movie=False)
    assert [note for note in result.notes if "is left out of the comparison: its mesh is not that of" in note]


def test_a_failed_step_leaves_a_file_with_quadratic_cells(tmp_path, capfd):
    sections = {
        "method": {"iterations": "converged", "max_iterations": 3},
        "initial": {"velocity": [0.0, 300.0, -200.0]},
        "schedule": {"dt": 0.002, "frames": 20},
        "variants": {"only": {}},
    }
    path = write_case(tmp_path, **raise_order({}) | sections)
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--no-movie", "--quiet"]) == 3
    assert capfd.readouterr().err.count("\n") == 1
    grid = pyvista.read(tmp_path / "out" / "beam" / "only" / "failure.vtu")
    assert (grid.celltypes == 24).all() and np.isfinite(grid.cell_data["volume_ratio"]).all()
    assert all(len(values) == 18 for values in grid.cell_data.values())
    assert (grid.cell_data["volume_ratio_min"] <= grid.cell_data["volume_ratio"]).all()
    body = build(load_case(path).variant("only")).body
    assert grid.cell_data["energy_density"] @ body.mesh.rest_volumes == pytest.approx(
        body.energy(np.asarray(grid.points)), rel=1e-10
    )
