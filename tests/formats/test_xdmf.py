"""XDMF as many programs write it: hand-written files with known values, other readers' arrays, and bad input."""

import zlib
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy

from pipeline.errors import SeriesError
from pipeline.formats.cell_types import CORNERS
from pipeline.formats.readers import read_grid, read_times
from pipeline.mesh.shapes import box
from pipeline.series.files import frame_files

MESH = box((2.0, 1.0, 1.0), (2, 1, 1))
X, CELLS = MESH.points, MESH.cells
U = [np.stack([s * X[:, 0], 0 * X[:, 1], 0 * X[:, 2]], axis=1) for s in (0.0, 0.2, 0.5)]
TIMES = [0.0, 0.1, 0.2]
XI = 'xmlns:xi="http://www.w3.org/2001/XInclude"'


def item(values, **attributes):
    values = np.asarray(values)
    kind = "Float" if values.dtype.kind == "f" else "Int"
    attributes = {
        "Dimensions": " ".join(map(str, values.shape)),
        "NumberType": kind,
        "Precision": "8",
        "Format": "XML",
    } | attributes
    text = " ".join(repr(v) for v in values.ravel().tolist())
    return f"<DataItem {join(attributes)}>{text}</DataItem>"


def join(attributes):
    return " ".join(f'{key}="{value}"' for key, value in attributes.items())


def mesh(points=X, cells=CELLS, kind="Tetrahedron"):
    return (
        f'<Topology TopologyType="{kind}" NumberOfElements="{len(cells)}">{item(cells)}</Topology>'
        f'<Geometry GeometryType="XYZ">{item(points)}</Geometry>'
    )


def vector(values, name="u", center="Node", kind="Vector"):
    return f'<Attribute Name="{name}" AttributeType="{kind}" Center="{center}">{item(values)}</Attribute>'


def uniform(*content, time=None, name="g"):
    when = "" if time is None else f'<Time Value="{time}"/>'
    return f'<Grid Name="{name}" GridType="Uniform">{"".join(content)}{when}</Grid>'


def collection(*grids, kind="Temporal", name="c"):
    return f'<Grid Name="{name}" GridType="Collection" CollectionType="{kind}">{"".join(grids)}</Grid>'


def write(path, *content, root=XI):
    path.write_text(f'<?xml version="1.0"?>\n<Xdmf Version="3.0" {root}><Domain>{"".join(content)}</Domain></Xdmf>')
    return path


def assert_stretched(path, fields=("u",)):
    assert read_times(path) == TIMES
    for k, u in enumerate(U):
        grid = read_grid(path, k)
        assert np.array_equal(grid.points, X)
        assert np.array_equal(grid.connectivity.reshape(-1, 4), CELLS) and set(grid.types) == {10}
        assert np.array_equal(grid.point_data["u"], u)
        assert set(fields) <= {*grid.point_data, *grid.cell_data, *grid.field_data}
    return grid


def test_a_mesh_beside_the_collection_by_xpointer(tmp_path):
    pointer = "xpointer(/Xdmf/Domain/Grid[@GridType='Uniform'][1]/*[self::Topology or self::Geometry])"
    steps = [uniform(f'<xi:include xpointer="{pointer}"/>', vector(u), time=t) for t, u in zip(TIMES, U, strict=True)]
    grid = assert_stretched(write(tmp_path / "a.xdmf", uniform(mesh(), name="mesh"), collection(*steps)))
    assert grid.notes == ()


def test_the_mesh_of_the_first_step_by_a_name_in_the_path(tmp_path):
    pointer = "xpointer(//Grid[@Name=&quot;c&quot;]/Grid[1]/*[self::Topology or self::Geometry])"
    steps = [
        uniform(mesh() if k == 0 else f'<xi:include xpointer="{pointer}"/>', vector(U[k]), time=TIMES[k])
        for k in range(3)
    ]
    assert_stretched(write(tmp_path / "a.xmf", collection(*steps)))


@pytest.mark.parametrize("style", ["text", "attribute"])
def test_references(tmp_path, style):
    paths = {tag: f"/Xdmf/Domain/Grid[@Name='c']/Grid[1]/{tag}" for tag in ("Topology", "Geometry")}
    refer = {
        tag: f'<{tag} Reference="XML">{path}</{tag}>' if style == "text" else f'<{tag} Reference="{path}[1]"/>'
        for tag, path in paths.items()
    }
    steps = [uniform(mesh() if k == 0 else "".join(refer.values()), vector(U[k]), time=TIMES[k]) for k in range(3)]
    assert_stretched(write(tmp_path / "a.xdmf", collection(*steps)))


def test_data_items_in_the_domain(tmp_path):
    shared = item(X).replace("<DataItem ", '<DataItem Name="points" ') + item(CELLS).replace(
        "<DataItem ", '<DataItem Name="cells" '
    )
    refer = '<DataItem Reference="XML">/Xdmf/Domain/DataItem[@Name="{}"]</DataItem>'
    body = (
        f'<Topology TopologyType="Tetrahedron" NumberOfElements="{len(CELLS)}">{refer.format("cells")}</Topology>'
        f'<Geometry GeometryType="XYZ">{refer.format("points")}</Geometry>'
    )
    steps = [uniform(body, vector(u), time=t) for t, u in zip(TIMES, U, strict=True)]
    assert_stretched(write(tmp_path / "a.xdmf", shared, collection(*steps)))


@pytest.mark.parametrize("order", [1, -1])
def test_one_collection_a_function(tmp_path, order):
    u = collection(*[uniform(mesh(), vector(u), time=t) for t, u in zip(TIMES, U, strict=True)], name="u")
    stress = [np.full((len(CELLS), 9), float(k)) for k in range(3)]
    tensor = [
        uniform(mesh(), vector(s, "stress", "Cell", "Tensor"), time=t) for t, s in zip(TIMES, stress, strict=True)
    ]
    path = write(tmp_path / "a.xdmf", *[u, collection(*tensor, name="s")][::order])
    grid = assert_stretched(path, ("u", "stress"))
    assert grid.cell_data["stress"].shape == (len(CELLS), 9) and (grid.cell_data["stress"] == 2).all()


def test_collections_with_different_times(tmp_path):
    u = collection(*[uniform(mesh(), vector(u), time=t) for t, u in zip(TIMES, U, strict=True)])
    heat = collection(uniform(mesh(), vector(X[:, 0], "T", kind="Scalar"), time=0.2))
    path = write(tmp_path / "a.xdmf", heat, u)
    grid = assert_stretched(path)
    assert np.array_equal(grid.point_data["T"], X[:, 0]) and "T" not in read_grid(path, 1).point_data
    assert any("joined to 3 instants" in note for note in grid.notes)


def test_two_functions_of_one_name_and_two_meshes(tmp_path):
    f = [collection(uniform(mesh(), vector(u, "f"), time=0.0)) for u in U[1:]]
    grid = read_grid(write(tmp_path / "a.xdmf", *f), 0)
    assert np.array_equal(grid.point_data["f"], U[1]) and np.array_equal(grid.point_data["f_2"], U[2])
    assert any("f_2" in note for note in grid.notes)
    other = collection(uniform(mesh(X + 1), vector(U[0], "p"), time=0.0))
    with pytest.raises(SeriesError, match=r"different meshes.*a file of its own"):
        read_grid(write(tmp_path / "b.xdmf", f[0], other), 0)


def test_equal_times_stay_apart(tmp_path):
    steps = [uniform(mesh(), vector(u), time=0.5) for u in U]
    path = write(tmp_path / "a.xdmf", collection(*steps))
    assert read_times(path) == [0.5] * 3
    for k, u in enumerate(U):
        assert np.array_equal(read_grid(path, k).point_data["u"], u)


@pytest.mark.parametrize("inner", ["Spatial", "Temporal"])
def test_partitions(tmp_path, inner):
    halves = [CELLS[: len(CELLS) // 2], CELLS[len(CELLS) // 2 :]]
    parts = []
    for cells in halves:
        nodes = np.unique(cells)
        parts.append((nodes, np.searchsorted(nodes, cells)))
    grids = [[uniform(mesh(X[n], c), vector(u[n]), time=t) for n, c in parts] for t, u in zip(TIMES, U, strict=True)]
    if inner == "Spatial":
        content = collection(*[collection(*step, kind="Spatial") for step in grids])
    else:
        content = collection(*[collection(*part) for part in zip(*grids, strict=True)], kind="Spatial")
    path = write(tmp_path / "a.xdmf", content)
    assert read_times(path) == TIMES
    grid = frame_files.read_grid(path, 2)  # through the child
    assert grid.parts == tuple(len(n) for n, _ in parts) and grid.count == sum(grid.parts)
    assert np.array_equal(grid.points[grid.connectivity], X[np.concatenate(halves).ravel()])
    assert np.array_equal(grid.point_data["u"], np.concatenate([U[2][n] for n, _ in parts]))


def test_a_moving_geometry(tmp_path):
    steps = [uniform(mesh(X + u), time=t) for t, u in zip(TIMES, U, strict=True)]
    path = write(tmp_path / "a.xdmf", collection(*steps))
    for k, u in enumerate(U):
        assert np.array_equal(read_grid(path, k).points, X + u)


@pytest.mark.parametrize(
    ("time", "expected"),
    [
        ('<Time TimeType="List"><DataItem Dimensions="3">0.0 0.5 3.0</DataItem></Time>', [0, 0.5, 3]),
        ('<Time TimeType="HyperSlab"><DataItem Dimensions="3">1.0 0.5 3</DataItem></Time>', [1, 1.5, 2]),
        ('<Time TimeType="Range"><DataItem Dimensions="2">1.0 2.0</DataItem></Time>', [1, 1.5, 2]),
        ("", [0, 1, 2]),
    ],
)
def test_times_of_a_collection(tmp_path, time, expected):
    path = write(tmp_path / "a.xdmf", collection(time, *[uniform(mesh(), vector(u)) for u in U]))
    assert read_times(path) == expected
    assert np.array_equal(read_grid(path, 2).point_data["u"], U[2])
    assert bool(read_grid(path, 0).notes) == ("Range" in time or not time)


def test_single_grids_with_times_are_a_series(tmp_path):
    assert_stretched(
        write(tmp_path / "a.xdmf", *[uniform(mesh(), vector(u), time=t) for t, u in zip(TIMES, U, strict=True)])
    )
    path = write(tmp_path / "b.xdmf", uniform(mesh(), vector(U[1])))
    assert read_times(path) is None and np.array_equal(read_grid(path, 0).point_data["u"], U[1])


def test_boundary_marks_are_left_out_with_a_note(tmp_path):
    marks = uniform(
        mesh(cells=CELLS[:, :3], kind="Triangle"),
        vector(np.arange(len(CELLS)), "facets", "Cell", "Scalar"),
        name="marks",
    )
    domains = vector(np.arange(len(CELLS)), "domain", "Cell", "Scalar")
    path = write(tmp_path / "a.xdmf", uniform(mesh(), domains, name="mesh"), marks)
    grid = read_grid(path, 0)
    assert set(grid.types) == {10} and grid.cell_data["domain"].tolist() == list(range(len(CELLS)))
    assert any("marks" in note for note in grid.notes)
    steps = collection(*[uniform(mesh(), vector(u), time=t) for t, u in zip(TIMES, U, strict=True)])
    grid = assert_stretched(
        write(tmp_path / "b.xdmf", uniform(mesh(), domains, name="mesh"), marks, steps), ("u", "domain")
    )
    assert any("marks" in note for note in grid.notes)


@pytest.mark.parametrize("how", ["region", "hyperslab", "coordinates"])
def test_parts_of_a_dataset(tmp_path, how):
    """OpenGeoSys keeps all times of a field in one dataset, and names the part of it behind bars."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["meshes/m/geometry"] = X[None]
        file["meshes/m/topology"] = CELLS.ravel()
        file["meshes/m/u"] = np.array(U)
    n, e = len(X), CELLS.size

    def u(k):
        whole = (
            f'<DataItem Dimensions="3 {n} 3" Format="HDF" NumberType="Float" Precision="8">a.h5:/meshes/m/u</DataItem>'
        )
        if how == "region":
            return (
                f'<DataItem DataType="Float" Dimensions="1 {n} 3" Format="HDF" Precision="8">'
                f"a.h5:/meshes/m/u|{k} 0 0:1 1 1:1 {n} 3:3 {n} 3</DataItem>"
            )
        if how == "hyperslab":
            slab = item(np.array([[k, 0, 0], [1, 1, 1], [1, n, 3]]))
            return f'<DataItem ItemType="HyperSlab" Dimensions="{n} 3">{slab}{whole}</DataItem>'
        places = np.array([(k, i, j) for i in range(n) for j in range(3)])
        return f'<DataItem ItemType="Coordinates" Dimensions="{n} 3">{item(places)}{whole}</DataItem>'

    body = (
        f'<Geometry Type="XYZ"><DataItem DataType="Float" Dimensions="1 {n} 3" Format="HDF" Precision="8">'
        f"a.h5:/meshes/m/geometry|0 0 0:1 1 1:1 {n} 3:1 {n} 3</DataItem></Geometry>"
        f'<Topology Type="Tetrahedron" NumberOfElements="{len(CELLS)}" Dimensions="{len(CELLS)}">'
        f'<DataItem DataType="UInt" Dimensions="{e}" Format="HDF" Precision="8">a.h5:/meshes/m/topology|0:1:{e}:{e}'
        "</DataItem></Topology>"
    )
    start = (
        '<Attribute Center="Node" ElementCell="" ElementDegree="0" ElementFamily="" ItemType="" Name="u" '
        'AttributeType="Vector">'
    )
    steps = [
        uniform(
            body,
            start + u(k) + "</Attribute>",
            time=t,
        )
        for k, t in enumerate(TIMES)
    ]
    path = write(tmp_path / "a.xdmf", collection(*steps))
    assert_stretched(path)
    path.write_text(path.read_text().replace(f"|1 0 0:1 1 1:1 {n} 3", f"|3 0 0:1 1 1:1 {n} 3"))
    if how == "region":
        with pytest.raises(SeriesError, match="hyperslab ends at"):
            read_grid(path, 1)


@pytest.mark.parametrize(
    ("order", "endian", "seek", "compression"),
    [("<", "Little", 0, "Raw"), (">", "Big", 24, "Raw"), (">", "Big", 5, "Zlib"), ("=", "Native", 0, "Raw")],
)
def test_binary_files(tmp_path, order, endian, seek, compression):
    def item_in_file(values, name):
        kind = "Float" if values.dtype.kind == "f" else "Int"
        content = values.astype(f"{order}{values.dtype.kind}8").tobytes()
        content = zlib.compress(content) if compression == "Zlib" else content
        (tmp_path / name).write_bytes(b"#" * seek + content + b"behind")
        attributes = {"Dimensions": " ".join(map(str, values.shape)), "NumberType": kind, "Precision": 8,
                      "Format": "Binary", "Endian": endian, "Seek": seek, "Compression": compression}  # fmt: skip
        return f"<DataItem {join(attributes)}>{name}</DataItem>"

    body = (
        f'<Topology TopologyType="Tetrahedron" NumberOfElements="{len(CELLS)}">{item_in_file(CELLS, "c")}</Topology>'
        f'<Geometry GeometryType="XYZ">{item_in_file(X, "x")}</Geometry>'
    )
    steps = [
        uniform(
            body if k == 0 else "",
            f'<Attribute Name="u" AttributeType="Vector">{item_in_file(u, f"u{k}")}</Attribute>',
            time=t,
        )
        for k, (t, u) in enumerate(zip(TIMES, U, strict=True))
    ]
    path = write(tmp_path / "a.xdmf", collection(*steps))
    assert_stretched(path)
    text = (tmp_path / "u1").read_bytes()
    (tmp_path / "u1").write_bytes(text[: seek + 10])
    with pytest.raises(SeriesError, match=r"too short|decompresses to|incomplete|cannot be read"):
        read_grid(path, 1)


def test_files_by_absolute_paths(tmp_path):
    inside, outside = tmp_path / "in", tmp_path / "out"
    inside.mkdir()
    outside.mkdir()
    for folder in (inside, outside):
        with h5py.File(folder / "a.h5", "w") as file:
            file["x"] = X
    body = mesh().replace(item(X), f'<DataItem Dimensions="{len(X)} 3" Format="HDF">PLACE:/x</DataItem>')
    path = write(inside / "a.xdmf", uniform(body.replace("PLACE", str(inside / "a.h5"))))
    assert np.array_equal(read_grid(path, 0).points, X)
    for name in (outside / "a.h5", "../out/a.h5"):
        path = write(inside / "b.xdmf", uniform(body.replace("PLACE", str(name))))
        with pytest.raises(SeriesError, match=r"outside its own folder.*put it beside"):
            read_grid(path, 0)


def test_included_files(tmp_path):
    for k, (t, u) in enumerate(zip(TIMES, U, strict=True)):
        write(tmp_path / f"step{k}.xmf", uniform(mesh(), vector(u), time=t))
    links = [f'<xi:include href="step{k}.xmf" xpointer="xpointer(//Xdmf/Domain/Grid)"/>' for k in range(3)]
    assert_stretched(write(tmp_path / "a.xdmf", collection(*links)))
    (tmp_path / "x.txt").write_text(" ".join(map(repr, X.ravel().tolist())))
    body = mesh().replace(
        item(X), f'<DataItem Dimensions="{len(X)} 3"><xi:include parse="text" href="x.txt"/></DataItem>'
    )
    assert np.array_equal(read_grid(write(tmp_path / "b.xdmf", uniform(body)), 0).points, X)


def read_by_vtk(path, time=None):
    from vtkmodules.vtkIOXdmf2 import vtkXdmfReader

    reader = vtkXdmfReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    reader.UpdateTimeStep(time) if time is not None else reader.Update()
    return reader.GetOutputDataObject(0)


CODES = {"Triangle": 5, "Quadrilateral": 9, "Tetrahedron": 10, "Pyramid": 14, "Wedge": 13, "Hexahedron": 12,
         "Edge_3": 21,
         "Triangle_6": 22, "Quadrilateral_8": 23, "Quadrilateral_9": 28, "Tetrahedron_10": 24, "Pyramid_13": 27,
         "Wedge_15": 26, "Wedge_18": 32, "Hexahedron_20": 25, "Hexahedron_24": 33, "Hexahedron_27": 29}  # fmt: skip


@pytest.mark.parametrize("name", CODES)
def test_kinds_of_cells_are_those_of_vtk(tmp_path, name):
    width = CORNERS[CODES[name]]
    points = np.random.default_rng(1).random((2 * width, 3))
    cells = np.random.default_rng(2).permutation(2 * width).reshape(2, width)
    path = write(tmp_path / "a.xdmf", uniform(mesh(points, cells, name)))
    ours, theirs = read_grid(path, 0), read_by_vtk(path)
    assert set(ours.types) == {CODES[name]} == {theirs.GetCellType(0)}
    assert np.array_equal(ours.connectivity, vtk_to_numpy(theirs.GetCells().GetConnectivityArray()))
    assert np.array_equal(ours.connectivity, cells.ravel())
    assert ours.points == pytest.approx(vtk_to_numpy(theirs.GetPoints().GetData()), rel=1e-6)


LINEAR_CODES = {5: (4, 3), 9: (5, 4), 10: (6, 4), 14: (7, 5), 13: (8, 6), 12: (9, 8)}


@pytest.mark.parametrize("more", [{}, {24: (0x26, 10), 25: (0x30, 20)}])
def test_mixed_cells_are_those_of_vtk_and_meshio(tmp_path, more):
    rng = np.random.default_rng(3)
    points = rng.random((30, 3))
    kinds = LINEAR_CODES | more
    chosen = [*rng.choice(list(kinds), 40).tolist(), *[10] * 1000, *rng.choice(list(kinds), 20).tolist()]
    stream, flat = list[int](), list[int]()
    for kind in chosen:
        code, width = kinds[kind]
        nodes = rng.integers(0, 30, width).tolist()
        stream += [code, *nodes]
        flat += nodes
    body = f'<Topology TopologyType="Mixed" NumberOfElements="{len(chosen)}">{item(np.array(stream))}</Topology>'
    path = write(tmp_path / "a.xdmf", uniform(body, f'<Geometry GeometryType="XYZ">{item(points)}</Geometry>'))
    ours, theirs = read_grid(path, 0), read_by_vtk(path)
    assert ours.types.tolist() == chosen == [theirs.GetCellType(i) for i in range(theirs.GetNumberOfCells())]
    assert ours.connectivity.tolist() == flat == vtk_to_numpy(theirs.GetCells().GetConnectivityArray()).tolist()
    if not more:  # meshio reads no others
        blocks = meshio.read(path).cells
        assert np.concatenate([block.data.ravel() for block in blocks]).tolist() == flat


def test_mixed_cells_with_counts_and_faces(tmp_path):
    cube = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
    stream = [1, 1, 3, 2, 2, 0, 1, 3, 5, 0, 1, 2, 3, 4, 16, 6, *[n for face in cube for n in (4, *face)], 6, 0, 1, 2, 4]
    points = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)], dtype=float)
    body = f'<Topology TopologyType="Mixed" NumberOfElements="5">{item(np.array(stream))}</Topology>'
    path = write(tmp_path / "a.xdmf", uniform(body, f'<Geometry GeometryType="XYZ">{item(points)}</Geometry>'))
    grid = frame_files.read_grid(path, 0)
    assert grid.types.tolist() == [2, 4, 7, 42, 10] and np.diff(grid.offsets).tolist() == [1, 2, 5, 8, 4]
    assert grid.faces is not None and grid.faces.cell_offsets.tolist() == [0, 0, 0, 0, 6, 6]
    assert grid.faces.connectivity.tolist() == [n for face in cube for n in face]
    for end in range(1, len(stream) - 1):
        cut = body.replace(item(np.array(stream)), item(np.array(stream[:end])))
        write(path, uniform(cut, f'<Geometry GeometryType="XYZ">{item(points)}</Geometry>'))
        with pytest.raises(SeriesError, match=r"ends within|declares 5 cells|without faces"):
            read_grid(path, 0)


STRUCTURED = {
    "3DCoRectMesh": ("ORIGIN_DXDYDZ", [np.array([3.0, 2.0, 1.0]), np.array([0.3, 0.2, 0.1])]),
    "3DRectMesh": ("VXVYVZ", [np.linspace(0, 1, 4), np.linspace(0, 2, 3), np.array([0.0, 5.0])]),
    "3DSMesh": ("XYZ", [np.random.default_rng(5).random((2, 3, 4, 3))]),
}


@pytest.mark.parametrize("kind", STRUCTURED)
def test_structured_grids_are_those_of_vtk(tmp_path, kind):
    geometry, arrays = STRUCTURED[kind]
    body = (
        f'<Topology TopologyType="{kind}" Dimensions="2 3 4"/>'
        f'<Geometry GeometryType="{geometry}">{"".join(item(a) for a in arrays)}</Geometry>'
    )
    path = write(
        tmp_path / "a.xdmf",
        uniform(
            body,
            vector(np.arange(24.0).reshape(2, 3, 4), "n", kind="Scalar"),
            vector(np.arange(6).reshape(1, 2, 3), "e", "Cell", "Scalar"),
        ),
    )
    ours, theirs = read_grid(path, 0), read_by_vtk(path)
    assert ours.count == theirs.GetNumberOfPoints() == 24 and len(ours.types) == theirs.GetNumberOfCells() == 6
    assert ours.points == pytest.approx(np.array([theirs.GetPoint(i) for i in range(24)]), rel=1e-6)
    for i in range(6):
        nodes = ours.connectivity[8 * i : 8 * i + 8]
        ids = [theirs.GetCell(i).GetPointId(k) for k in range(8)]
        order = range(8) if theirs.GetCellType(i) == 12 else (0, 1, 3, 2, 4, 5, 7, 6)  # a voxel's
        assert nodes.tolist() == [ids[k] for k in order]
    assert ours.point_data["n"].tolist() == list(range(24)) and ours.cell_data["e"].tolist() == list(range(6))


def test_plane_geometries(tmp_path):
    x, y = np.meshgrid([0.0, 1.0, 3.0], [0.0, 2.0])
    expected = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    for number, (kind, geometry, arrays) in enumerate([
        ("2DRectMesh", "VXVY", [np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0])]),
        ("2DSMesh", "XY", [expected[:, :2]]),
        ("2DSMesh", "X_Y", [x.ravel(), y.ravel()]),
        ("2DSMesh", "X_Y_Z", [x, y, 0 * x]),
    ]):  # fmt: skip
        body = (
            f'<Topology TopologyType="{kind}" Dimensions="2 3"/>'
            f'<Geometry GeometryType="{geometry}">{"".join(item(a) for a in arrays)}</Geometry>'
        )
        grid = read_grid(write(tmp_path / f"{number}.xdmf", uniform(body)), 0)
        assert np.array_equal(grid.points, expected) and grid.connectivity.tolist() == [0, 1, 4, 3, 1, 2, 5, 4]


def test_functions_of_finite_elements(tmp_path):
    """As dolfin's write_checkpoint: degrees of freedom of each cell, component after component."""
    rng = np.random.default_rng(7)
    dofs = rng.permutation(3 * len(X)).reshape(len(X), 3)  # of each node
    order = rng.permutation(len(CELLS))
    numbers = np.concatenate([dofs[CELLS[order], k] for k in range(3)], axis=1)
    values = np.empty(3 * len(X))
    values[dofs] = U[1]

    def function(family, degree, numbers, values, name):
        starts = np.arange(len(CELLS) + 1) * numbers.shape[1]
        items = "".join(item(a) for a in (numbers.reshape(-1, 1), values.reshape(-1, 1), starts, order))
        return (
            f'<Attribute ItemType="FiniteElementFunction" ElementFamily="{family}" ElementDegree="{degree}" '
            f'ElementCell="tetrahedron" Name="{name}" Center="Other" AttributeType="Vector">{items}</Attribute>'
        )

    marks = rng.permutation(len(CELLS))
    path = write(
        tmp_path / "a.xdmf",
        collection(
            uniform(
                mesh(), function("CG", 1, numbers, values, "u"), function("DG", 0, order[:, None], marks, "m"), time=0.5
            )
        ),
    )
    grid = read_grid(path, 0)
    assert np.array_equal(grid.point_data["u"], U[1]) and np.array_equal(grid.cell_data["m"], marks)
    path = write(tmp_path / "b.xdmf", uniform(mesh(), function("CG", 2, numbers, values, "u")))
    with pytest.raises(SeriesError, match="u has the elements CG2: interpolate"):
        read_grid(path, 0)


@pytest.mark.parametrize("data_format", ["XML", "HDF", "Binary"])
def test_files_of_meshio_read_as_meshio_reads_them(tmp_path, monkeypatch, data_format):
    monkeypatch.chdir(tmp_path)
    with meshio.xdmf.TimeSeriesWriter("a.xdmf", data_format=data_format) as writer:
        writer.write_points_cells(X, [("tetra", CELLS[:5]), ("tetra", CELLS[5:])])
        for t, u in zip(TIMES, U, strict=True):
            writer.write_data(t, point_data={"u": u}, cell_data={"c": [np.arange(5.0), np.arange(len(CELLS) - 5.0)]})
    assert_stretched(Path("a.xdmf"), ("u", "c"))
    with meshio.xdmf.TimeSeriesReader("a.xdmf") as reader:
        reader.read_points_cells()
        for k in range(3):
            time, nodal, cellular = reader.read_data(k)
            assert time == TIMES[k] and np.array_equal(
                nodal["u"], frame_files.read_grid(Path("a.xdmf"), k).point_data["u"]
            )
            assert np.array_equal(
                np.concatenate(cellular["c"]), frame_files.read_grid(Path("a.xdmf"), k).cell_data["c"]
            )


BAD = {
    "function item": (
        mesh().replace("<DataItem ", '<DataItem ItemType="Function" Function="$0*2" ', 1), "has the type Function",
    ),
    "too few values": (mesh().replace(f'Dimensions="{len(X)} 3"', f'Dimensions="{len(X) + 1} 3"'), "has 36 values"),
    "a huge size": (mesh().replace(f'Dimensions="{len(X)} 3"', 'Dimensions="99999999999 3"'), "has 36 values"),
    "a word": (mesh().replace("0.0", "zero", 1), "no number"),
    "a far node": (mesh(cells=CELLS + 5), "refers to point"),
    "a negative node": (mesh(cells=CELLS - 1), "refers to point -1"),
    "an unknown kind": (mesh(kind="Hexahedron_64"), "has the type hexahedron_64"),
    "its own order": (mesh().replace("<Topology ", '<Topology Order="3 2 1 0" '), "Order of its own"),
    "no geometry": (mesh().split("<Geometry")[0], "no geometry"),
    "an unknown format": (mesh().replace('Format="XML"', 'Format="TIFF"', 1), "format tiff"),
    "half precision": (
        mesh().replace('NumberType="Float" Precision="8"', 'NumberType="Float" Precision="2"'),
        "precision 2",
    ),
    "a circle": ('<Topology Reference="/Xdmf/Domain/Grid/Grid/Topology"/>', "circle"),
    "a lost reference": ('<Topology Reference="/Xdmf/Domain/Nothing"/>', "leads nowhere"),
    "a wild path": ('<xi:include xpointer="xpointer(//Grid[position()=1])"/>', "not understood"),
    "components first": (mesh() + vector(U[1].T), "12 values are needed"),
    "a missing file": (
        mesh().replace('Format="XML"', 'Format="HDF"', 1).replace(">0 ", ">no.h5:/x ", 1),
        "does not exist|names no dataset",
    ),
    "a subset": ('</Grid><Grid GridType="Subset">', "type subset"),
    "nothing": ("</Grid></Domain><Domain><Grid>", "2 domains"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_one_line(tmp_path, name):
    content, words = BAD[name]
    path = write(tmp_path / "a.xdmf", collection(uniform(content, time=0.0)) if name != "nothing" else uniform(content))
    with pytest.raises(SeriesError, match=words) as caught:
        frame_files.read_grid(path, 0)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_cut_files_are_one_line(tmp_path):
    path = write(
        tmp_path / "a.xdmf", collection(*[uniform(mesh(), vector(u), time=t) for t, u in zip(TIMES, U, strict=True)])
    )
    whole = path.read_text()
    for end in range(0, len(whole) - 5, len(whole) // 40):
        path.write_text(whole[:end])
        with pytest.raises(SeriesError) as caught:
            frame_files.read_grid(path, 0)
        assert "\n" not in str(caught.value)
