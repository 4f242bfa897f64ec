"""Datasets as other packages of xarray's world read them: xugrid (UGRID), cf_xarray (CF), pint-xarray (units)."""

import cf_xarray.units
import numpy as np
import pint_xarray  # noqa: F401  (registers ds.pint)
import pytest
import xarray
import xugrid

from pipeline.case import load_case
from pipeline.cli import main
from pipeline.results.case_run import run_case
from pipeline.series.xarray_plugin import SeriesBackend
from tests.bodies import write_case
from tests.foreign.writers import STRETCHES, bar, index, plate, stretch, write_vtu

TRIANGLE, PIXEL, QUAD, TETRAHEDRON = 5, 8, 9, 10


def open_lazily(path, **options):
    return xarray.open_dataset(path, engine=SeriesBackend, **options)


def write_series(folder, points, blocks):
    """A body stretched along x, with the field x of its points and one number per cell."""
    count = sum(len(cells) for _, cells in blocks)
    for k, s in enumerate(STRETCHES):
        fields = {"warmth": points[:, 0] + k}, {"number": np.arange(count) + 100 * k}
        write_vtu(folder / f"f_{k}.vtu", stretch(points, s), blocks, *fields)
    index(folder)
    return folder / "s.pvd"


@pytest.fixture(params=["lazy", "netCDF"])
def planar(request, tmp_path):
    """Triangles in the plane: as opened, and after a way through a file."""
    points, cells = plate((3, 2))
    dataset = open_lazily(write_series(tmp_path, points, [(TRIANGLE, cells)]))
    if request.param == "lazy":
        yield dataset
        return
    dataset.to_netcdf(tmp_path / "a.nc", engine="netcdf4")
    with xarray.open_dataset(tmp_path / "a.nc", engine="netcdf4") as again:
        yield again


def test_xugrid_reads_the_topology_of_a_planar_body(planar):
    grid = xugrid.UgridDataset(planar).ugrid.grid
    points, cells = plate((3, 2))
    assert (grid.n_node, grid.n_face) == (len(points), len(cells))
    assert (grid.face_node_connectivity == cells).all()
    assert grid.node_coordinates == pytest.approx(points[:, :2])
    assert grid.area == pytest.approx(np.full(len(cells), 1 / 6))


def test_xugrid_knows_the_places_of_fields(planar):
    dataset = xugrid.UgridDataset(planar)
    assert dataset["warmth"].ugrid.grid.node_dimension in dataset["warmth"].dims
    left = dataset["number"].isel(time=2).ugrid.sel(x=slice(0, 2 / 3))  # by the centers of the faces
    assert left.values.tolist() == [200, 201, 202, 203]
    assert dataset["displacement"].isel(time=2, axis=0).max() == pytest.approx(1.0)


def test_cf_xarray_finds_axes_time_and_roles(planar):
    axes = planar.cf.axes
    assert axes == {"X": ["node_x"], "Y": ["node_y"], "T": ["time"]}
    assert planar.cf.standard_names["time"] == ["time"]
    assert planar.cf.cf_roles == {"mesh_topology": ["mesh"], "face_node_connectivity": ["connectivity"]}
    assert planar["displacement"].cf["X"].values == pytest.approx(plate((3, 2))[0][:, 0])
    assert planar.cf.isel(T=1)["warmth"].values == pytest.approx(planar["warmth"][1].values)


def test_a_solid_has_three_axes_and_volumes(tmp_path):
    points, cells = bar()
    dataset = open_lazily(write_series(tmp_path, points, [(TETRAHEDRON, cells)]))
    assert dataset.cf.axes == {"X": ["node_x"], "Y": ["node_y"], "Z": ["node_z"], "T": ["time"]}
    assert dataset.cf.cf_roles == {"mesh_topology": ["mesh"], "volume_node_connectivity": ["connectivity"]}
    topology = dataset["mesh"].attrs
    assert topology["topology_dimension"] == 3 and topology["node_coordinates"].split() == [
        "node_x",
        "node_y",
        "node_z",
    ]
    for key in ("volume_node_connectivity", "volume_shape_type"):
        assert topology[key] in dataset.variables
    kinds = dataset["cell_type"]
    assert np.atleast_1d(kinds.attrs["flag_values"]).tolist() == [TETRAHEDRON]
    assert kinds.attrs["flag_meanings"] == "tetrahedron" and (kinds == TETRAHEDRON).all()
    assert dataset["number"].attrs["location"] == "volume" and dataset["warmth"].attrs["location"] == "node"
    assert dataset["warmth"].attrs["mesh"] == "mesh"
    ratio = dataset.deformation.volume_ratio()
    assert (
        ratio.attrs["location"] == "volume" and "location" not in dataset.deformation.probe("warmth", [1, 0, 0]).attrs
    )


@pytest.mark.parametrize(
    "name", ["displacement", "rest_position", "velocity", "volume_ratio", "rotation_angle", "time"]
)
def test_pint_reads_every_unit(tmp_path, name):
    points, cells = bar()
    for k, s in enumerate(STRETCHES):
        write_vtu(tmp_path / f"f_{k}.vtu", stretch(points, s), [(TETRAHEDRON, cells)], {"velocity": points})
    index(tmp_path)
    dataset = open_lazily(tmp_path / "s.pvd").load()
    dataset["volume_ratio"], dataset["rotation_angle"] = (
        dataset.deformation.volume_ratio(), dataset.deformation.rotation_angle()
    )  # fmt: skip
    quantities = dataset.pint.quantify(unit_registry=cf_xarray.units.units)
    expected = {"velocity": "m / s", "volume_ratio": "", "rotation_angle": "degree", "time": "s"}.get(name, "m")
    units = (
        quantities[name].pint.units if name != "time" else cf_xarray.units.units(dataset["time"].attrs["units"]).units
    )
    assert units == cf_xarray.units.units(expected).units
    if name == "displacement":
        assert quantities[name].pint.to("mm").max().item().magnitude == pytest.approx(1000.0)


def test_all_units_of_statistics_parse():
    """Those of every variable of statistics.nc, in space and in the plane."""
    from pipeline.run.measures import FIXED, STEPS, VARIABLES, get_units

    for name in {**VARIABLES, **STEPS, **FIXED}:
        for dimension in (2, 3):
            cf_xarray.units.units(get_units(name, dimension))
    assert cf_xarray.units.units("m3").dimensionality == cf_xarray.units.units("m^3").dimensionality


def test_statistics_of_a_run_and_of_an_analysis_are_conventional(tmp_path):
    """cf_xarray finds time and its dimension, and pint reads the unit of every variable."""
    folder = run_case(load_case(write_case(tmp_path, movie=None)), tmp_path / "out", movie=False).folder
    assert main(["analyze", str(folder / "linear" / "series.pvd"), "--out", str(tmp_path / "analysis")]) == 0
    ours = (folder / "linear" / "statistics.nc", folder / "comparison.nc")
    for path in (*ours, tmp_path / "analysis" / "statistics.nc"):
        with xarray.open_dataset(path, engine="netcdf4") as dataset:
            assert dataset.cf.axes == {"T": ["time"]} and dataset.cf.standard_names == {"time": ["time"]}
            assert dataset.cf["T"].name == "time" and dataset.cf.isel(T=-1)["time"] == dataset["time"][-1]
            numbers = [name for name in dataset.variables if dataset[name].dtype.kind == "f"]
            assert len(numbers) > 8
            for name in numbers:
                cf_xarray.units.units(dataset[name].attrs["units"])
            quantities = dataset.load().pint.quantify(unit_registry=cf_xarray.units.units)
            assert quantities["rotation_angle"].pint.to("radian").max().item().magnitude < np.pi
