"""Datasets of cells of any kind: to files of every kind and back, parts of them, points in them, and pictures."""

import numpy as np
import pytest
import pyvista
import xarray
import xugrid

from pipeline.errors import SeriesError
from pipeline.formats.cell_kinds import TYPES
from pipeline.formats.grid import CellArray, Grid, PolyhedronFaces, have_same_cells
from pipeline.mesh.cell_mesh import CellMesh
from pipeline.mesh.shape_functions import find_kind
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.simplex import Mesh
from pipeline.run.measures import AXES, measure, pad_to_space
from pipeline.series import read_series
from pipeline.series.dataset.mesh_variables import describe_mesh, read_mesh
from pipeline.series.dataset.pyvista_grid import build_grid
from pipeline.series.xarray_plugin import SeriesBackend
from tests.mesh.test_locate import draw_natural, list_kinds, make_prism, place_nodes

TIMES = [0.0, 0.5, 1.0]
STRETCH = np.diag([1.5, 1.2, 0.8])
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def join(*parts):
    """The points and cells of several (VTK's type, points[, faces]), three meters apart along x."""
    points, nodes, ends, types, faces, sizes, counts = [], [], [0], [], [], [0], [0]
    for k, (kind, x, *rings) in enumerate(parts):
        first = sum(map(len, points))
        points.append(np.asarray(x) + np.eye(1, np.shape(x)[1]) * 3 * k)
        nodes += range(first, first + len(x))
        ends.append(len(nodes))
        types.append(kind)
        for ring in rings[0] if rings else ():
            faces += [first + i for i in ring]
            sizes.append(len(faces))
        counts.append(len(sizes) - 1)
    polyhedra = PolyhedronFaces(np.array(faces), np.array(sizes), np.array(counts)) if faces else None
    cells = CellArray(np.array(types, dtype=np.uint8), np.array(ends), np.array(nodes), polyhedra)
    return np.concatenate(points), cells


def place(cell_type, count):
    return cell_type, place_nodes(find_kind(cell_type, count))


def make_solid():
    """One cell of many kinds each, curved ones and polyhedra among them."""
    kinds = [(10, 4), (12, 8), (11, 8), (13, 6), (14, 5), (24, 10), (25, 20), (29, 27), (26, 15), (27, 13), (72, 64)]
    prism, faces = make_prism(5)
    return CellMesh(*join(*(place(*kind) for kind in kinds), (42, prism, faces), (15, prism)), 3)


def make_plate(lift=None):
    """Triangles, quadrilaterals, a pixel, curved cells and a polygon, in the plane or lifted into space."""
    angle = 2 * np.pi * np.arange(7) / 7
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    kinds = [(5, 3), (9, 4), (8, 4), (22, 6), (23, 8), (28, 9), (69, 10), (70, 16)]
    points, cells = join(*(place(*kind) for kind in kinds), (7, ring))
    if lift is None:
        return CellMesh(points, cells, 2)
    return CellMesh(points @ lift, cells, 2, plane=lift)


PLANE = np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])


def make_surface():
    mesh = make_plate()
    x, y = mesh.points.T
    return CellMesh(np.column_stack([x, y, 0.1 * x**2]), mesh.cell_array, 2)


MESHES = {
    "solid": make_solid,
    "plate": make_plate,
    "plane in space": lambda: make_plate(PLANE),
    "surface": make_surface,
    "tetrahedra": lambda: box((2.0, 1.0, 1.0), (2, 1, 1)),
    "triangles": lambda: rectangle((2.0, 1.0), (2, 1)),
}


def move(mesh, time):
    """Positions at a time: stretched, then turned; in a plane within it."""
    F = np.eye(3) + time * (STRETCH - np.eye(3))
    points = mesh.points if mesh.points.shape[1] == 3 else pad_to_space(mesh.points)
    plane = getattr(mesh, "plane", None)
    if plane is not None:
        return points @ plane.T @ F[:2, :2] @ plane
    x = points @ F @ (TURN if time == 1.0 else np.eye(3))
    return x if mesh.points.shape[1] == 3 else x * [1, 1, 0]


def make_dataset(mesh):
    described = describe_mesh(mesh)
    rest = pad_to_space(mesh.points)
    moves = np.stack([move(mesh, t) - rest for t in TIMES])
    count = len(mesh.cell_array.types)
    variables = described.variables | {
        "displacement": (("time", "node", "axis"), moves, {"units": "m", "long_name": "position minus rest position"}),
        "warmth": (("time", "node"), rest[:, 0] + np.array(TIMES)[:, None]),
        "number": (("time", "cell"), np.arange(count) + 100 * np.arange(3)[:, None]),
    }
    coordinates = described.coordinates | {"time": ("time", TIMES, {"units": "s"}), "axis": list(AXES)}
    return xarray.Dataset(variables, coordinates, {"Conventions": "CF-1.11 UGRID-1.0", "title": "any cells"})


@pytest.fixture(params=MESHES)
def mesh(request):
    return MESHES[request.param]()


def assert_same_mesh(a, b):
    assert type(a) is type(b) and a.dimension == b.dimension
    assert np.array_equal(a.points, b.points)
    for one, other in zip(a.cell_array[:3], b.cell_array[:3], strict=True):
        assert one.dtype == other.dtype and np.array_equal(one, other)
    assert (a.cell_array.faces is None) == (b.cell_array.faces is None)
    for one, other in zip(a.cell_array.faces or (), b.cell_array.faces or (), strict=True):
        assert np.array_equal(one, other)
    assert np.array_equal(getattr(a, "plane", None), getattr(b, "plane", None))


def test_a_mesh_survives_as_variables_and_in_files(mesh, tmp_path):
    dataset = make_dataset(mesh)
    assert_same_mesh(read_mesh(dataset), mesh)
    dataset.to_netcdf(tmp_path / "a.nc", engine="netcdf4")
    dataset.to_zarr(tmp_path / "a.zarr")
    with xarray.open_dataset(tmp_path / "a.nc", engine="netcdf4") as again:
        assert_same_mesh(read_mesh(again), mesh)
        assert_measures_as(again, dataset)
        again.to_netcdf(tmp_path / "b.nc", engine="netcdf4")  # from NaN for -1
    with xarray.open_dataset(tmp_path / "b.nc", engine="netcdf4", mask_and_scale=False) as raw:
        assert_same_mesh(read_mesh(raw), mesh)
        assert (raw["connectivity"].values == dataset["connectivity"].values).all()
    assert_measures_as(xarray.open_zarr(tmp_path / "a.zarr"), dataset)


def assert_measures_as(a, b):
    for name in ("volume_ratio", "volume_ratio_min", "volume_ratio_max", "rotation_angle", "is_inverted"):
        xarray.testing.assert_identical(getattr(a.deformation, name)(), getattr(b.deformation, name)())


def test_the_accessor_measures_an_affine_motion_exactly(mesh):
    dataset = make_dataset(mesh)
    areas = [1.0, 1.25 * 1.1, 1.5 * 1.2]
    if mesh.dimension == 3:
        expected = [1.0, 1.25 * 1.1 * 0.9, 1.5 * 1.2 * 0.8]
    elif mesh.points.shape[1] == 3 and getattr(mesh, "plane", None) is None:
        expected = None
    else:
        expected = areas
    ratio = dataset.deformation.volume_ratio()
    assert ratio.dims == ("time", "cell") and "cell_type" in ratio.coords
    if expected is None:
        assert ratio[0].values == pytest.approx(1) and (ratio[2] > 1).all()
        return
    for k, value in enumerate(expected):
        for name in ("volume_ratio", "volume_ratio_min", "volume_ratio_max"):
            assert getattr(dataset.deformation, name)()[k].values == pytest.approx(value, rel=1e-10), name
    assert dataset.deformation.rotation_angle()[1].values == pytest.approx(0, abs=1e-5)
    assert dataset.deformation.worst().time == max(zip(expected, TIMES, strict=True), key=lambda p: abs(p[0] - 1))[1]
    assert not dataset.deformation.is_inverted().any()


def test_chunks_of_dask_measure_the_same(mesh):
    dataset = make_dataset(mesh)
    lazy = dataset.chunk(time=1, node=5).deformation.volume_ratio()
    assert lazy.chunks is not None
    xarray.testing.assert_identical(lazy.compute(), dataset.deformation.volume_ratio())


def test_some_cells_are_extracted_with_their_nodes_and_faces(mesh):
    dataset = make_dataset(mesh)
    chosen = [len(mesh.rest_volumes) - 1, 0, len(mesh.rest_volumes) - 2]
    part = dataset.deformation.extract(chosen)
    assert part["number"][0].values.tolist() == chosen
    rest = part["rest_position"].values
    assert part["warmth"][0].values == pytest.approx(rest[:, 0])
    xarray.testing.assert_equal(part.deformation.volume_ratio(), dataset.deformation.volume_ratio().isel(cell=chosen))
    whole = dataset.deformation.extract(np.arange(len(mesh.rest_volumes)))
    used = np.unique(mesh.cell_array.connectivity)
    assert len(used) == len(mesh.points)
    assert_same_mesh(read_mesh(whole), mesh)
    with pytest.raises(SeriesError, match="no cells were chosen"):
        dataset.deformation.extract([])


def test_fields_are_probed_at_points(mesh):
    dataset = make_dataset(mesh)
    centers = mesh.centers
    found = dataset.deformation.probe("warmth", centers)
    assert found.dims == ("time", "point")
    beside = (
        1e-9
        if dataset["mesh"].attrs["topology_dimension"] == 3 or "plane" in dataset or "node_z" not in dataset
        else 0.01
    )
    assert found.values == pytest.approx(centers[:, 0] + np.array(TIMES)[:, None], abs=beside)
    assert dataset.deformation.probe("number", centers)[0].values.tolist() == list(range(len(centers)))
    assert np.isnan(dataset.deformation.probe("displacement", centers + 100).values).all()


def test_pyvista_draws_any_cells(mesh):
    dataset = make_dataset(mesh)
    grid = dataset.deformation.to_pyvista(1.0)
    assert grid.n_cells == len(mesh.rest_volumes) and (grid.celltypes == mesh.cell_array.types).all()
    assert np.asarray(grid.points) == pytest.approx(move(mesh, 1.0))
    assert grid.cell_data["number"].tolist() == dataset["number"][2].values.tolist()
    straight = [k for k, kind in enumerate(mesh.cell_array.types.tolist()) if kind in (5, 9, 10, 12, 42)]
    sizes = grid.extract_cells(straight).compute_cell_sizes()[{2: "Area", 3: "Volume"}[mesh.dimension]]
    if not (mesh.dimension == 2 and mesh.points.shape[1] == 3 and getattr(mesh, "plane", None) is None):
        ratio = dataset.deformation.volume_ratio()[2].values
        assert np.abs(sizes) == pytest.approx((ratio * mesh.rest_volumes)[straight], rel=1e-6)
    node = mesh.cell_array.connectivity[0]
    dataset["displacement"][2, node] = np.nan
    assert dataset.deformation.to_pyvista(1.0).n_cells < len(mesh.rest_volumes)


# UGRID


def test_xugrid_reads_mixed_planar_cells():
    """Curved cells are polygons through all nodes on their sides: here these are straight, and the areas exact."""
    mesh = make_plate()
    grid = xugrid.UgridDataset(make_dataset(mesh)).ugrid.grid
    assert grid.n_face == len(mesh.rest_volumes)
    assert np.abs(grid.area) == pytest.approx(mesh.rest_volumes)


@pytest.mark.parametrize(("cell_type", "count"), [pair for pair in list_kinds() if TYPES[pair[0]].dimension == 2])
def test_nodes_around_a_planar_cell_are_in_order(cell_type, count):
    """The sides do not cross, and no node on them is left out: area and length are those of the reference cell."""
    kind = find_kind(cell_type, count)
    mesh = CellMesh(*join((cell_type, kind.nodes)), 2)
    variables = describe_mesh(mesh).variables
    name = variables["mesh"][2]["face_node_connectivity"]
    ring = variables[name][1][0]
    x, y = kind.nodes[ring[ring >= 0]].T
    assert (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2 == pytest.approx(0.5 if kind.shape == "triangle" else 1.0)
    length = np.hypot(np.roll(x, -1) - x, np.roll(y, -1) - y).sum()
    assert length == pytest.approx(2 + np.sqrt(2) if kind.shape == "triangle" else 4.0)
    assert ring[0] == 0


def test_topologies_name_variables_that_exist(mesh):
    dataset = make_dataset(mesh)
    topology = dataset["mesh"].attrs
    assert topology["topology_dimension"] == mesh.dimension
    assert len(topology["node_coordinates"].split()) == mesh.points.shape[1]
    named = [name for key, name in topology.items() if key.endswith(("connectivity", "shape_type"))]
    assert named and all(name in dataset.variables for name in named)
    assert {"face_dimension", "volume_dimension"} & topology.keys()
    meanings = dataset["cell_type"].attrs["flag_meanings"].split()
    assert len(meanings) == len(np.atleast_1d(dataset["cell_type"].attrs["flag_values"]))


def test_a_dataset_without_cell_types_holds_simplices():
    mesh = box((2.0, 1.0, 1.0), (2, 1, 1))
    dataset = make_dataset(mesh).drop_vars(["cell_type", "mesh", "node_x", "node_y", "node_z"])
    assert isinstance(read_mesh(dataset), Mesh)
    wrong = make_dataset(mesh)
    wrong["cell_type"][:] = 99
    with pytest.raises(SeriesError, match="cell_type 99 is not one of VTK's"):
        read_mesh(wrong)


# Files of frames


@pytest.mark.parametrize("name", MESHES)
def test_frames_of_any_cells_are_read_back(name, tmp_path):
    mesh = MESHES[name]()
    dataset = make_dataset(mesh)
    path = dataset.deformation.to_pvd(tmp_path / "a.pvd")
    with xarray.open_dataset(path, engine=SeriesBackend) as again:
        if name != "plane in space":  # the plane is found from the points, and rounded
            xarray.testing.assert_identical(again.load(), dataset)
        xarray.testing.assert_allclose(again.load(), dataset, rtol=1e-12, atol=1e-15)
        twice = xarray.open_dataset(again.deformation.to_pvd(tmp_path / "b.pvd"), engine=SeriesBackend)
        xarray.testing.assert_identical(twice.load(), again)
    theirs = pyvista.PVDReader(path).read()[0]
    assert theirs.n_cells == len(mesh.rest_volumes)
    rest = build_grid(pad_to_space(mesh.points), mesh.cell_array)
    assert (theirs.celltypes == rest.celltypes).all() and np.array_equal(
        theirs.cell_connectivity, rest.cell_connectivity
    )


def test_curved_positions_are_probed_as_their_shape_functions_say():
    rng = np.random.default_rng(0)
    kind = find_kind(25, 20)
    points = kind.nodes + 0.03 * rng.normal(size=kind.nodes.shape)
    mesh = CellMesh(*join((25, points)), 3)
    dataset = make_dataset(mesh)
    natural = draw_natural(kind, rng)
    field = rng.normal(size=len(points))
    dataset["f"] = (("node",), field)
    found = dataset.deformation.probe("f", kind.evaluate(natural) @ points)
    assert found.values == pytest.approx(kind.evaluate(natural) @ field, abs=1e-9)


def test_cells_chosen_without_their_faces_are_an_error():
    """isel takes cells of polyhedra away from their faces; extract takes both."""
    prism, faces = make_prism(5)
    dataset = make_dataset(CellMesh(*join((42, prism, faces), (42, prism, faces), (12, place(12, 8)[1])), 3))
    assert read_mesh(dataset.isel(cell=[0, 1])).rest_volumes == pytest.approx(read_mesh(dataset).rest_volumes[:2])
    for chosen in ([1], [0], [1, 0, 2], [2]):
        with pytest.raises(SeriesError, match="the faces are not those of the cells"):
            dataset.isel(cell=chosen).deformation.volume_ratio()
        assert len(read_mesh(dataset.deformation.extract(chosen)).rest_volumes) == len(chosen)


def test_polygons_of_other_lengths_are_other_cells():
    """Two lists of cells with equal points in order, and equal kinds, are not equal."""
    points = np.column_stack([make_plate().points[:8], np.zeros(8)])
    types, nodes = np.array([7, 7], dtype=np.uint8), np.arange(8)
    a, b = (Grid(points, 8, types, np.array([0, split, 8]), nodes, {}, {}, {}) for split in (3, 4))
    assert have_same_cells(a, a) and not have_same_cells(a, b)
    prism, faces = make_prism(5)
    cells = join((42, prism, faces))[1]
    a = Grid(prism, 10, *cells[:3], {}, {}, {}, faces=cells.faces)
    b = Grid(prism, 10, *cells[:3], {}, {}, {}, faces=join((42, prism, faces[:-1]))[1].faces)
    assert have_same_cells(a, a) and not have_same_cells(a, b)


PROGRAMS = [
    "dealii/lagrange.pvd", "dolfinx/hexahedra_2.pvd", "exodus/quadratic.exo", "openfoam/polyhedra/polyhedra.foam",
    "kratos/moving_points", "calculix/c3d20.frd", "mfem/wedges/wedges.pvd", "felupe/hexahedra_27.xdmf",
    "opengeosys/hexahedra.pvd",
]  # fmt: skip


@pytest.mark.parametrize("name", PROGRAMS)
def test_series_of_other_programs_go_through_every_file(name, tmp_path, project_root):
    """As the series measures them, as datasets of netCDF and zarr, and as frames, which VTK reads."""
    path = project_root / "tests" / "programs" / name
    dataset = xarray.open_dataset(path, engine=SeriesBackend).load()
    ratio = dataset.deformation.volume_ratio()
    for k, frame in enumerate(read_series(path)):
        assert ratio[k].values == pytest.approx(measure(frame)["volume_ratio"], rel=1e-9, nan_ok=True)
    dataset.to_netcdf(tmp_path / "a.nc", engine="netcdf4")
    dataset.to_zarr(tmp_path / "a.zarr")
    with xarray.open_dataset(tmp_path / "a.nc", engine="netcdf4") as again:
        xarray.testing.assert_identical(again.deformation.volume_ratio(), ratio)
    xarray.testing.assert_identical(xarray.open_zarr(tmp_path / "a.zarr").deformation.volume_ratio().load(), ratio)
    frames = dataset.deformation.to_pvd(tmp_path / "a.pvd")
    xarray.testing.assert_identical(xarray.open_dataset(frames, engine=SeriesBackend).load(), dataset)
