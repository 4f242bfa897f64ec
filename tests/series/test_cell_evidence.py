"""Cells by evidence: kinds, planes, orientation, copies, ghosts, parts, flat cells, and frames that change."""

import numpy as np
import pytest
import pyvista

from pipeline import read_series
from pipeline.cli import main
from pipeline.errors import SeriesError
from pipeline.mesh.shapes import box, rectangle
from pipeline.run.measures import measure
from tests.series.test_evidence import STRETCHES, assert_stretched, ratios, stretch
from tests.series.test_series import write_pvd

RNG = np.random.default_rng(4)
TETRAHEDRA = box([2.0, 1.0, 1.0], [3, 2, 2])
TRIANGLES = rectangle([2.0, 1.0], [4, 3])
FLAT = np.column_stack([TRIANGLES.points, np.zeros(len(TRIANGLES.points))])
IMAGE = pyvista.ImageData(dimensions=(4, 3, 3), spacing=(0.5, 0.4, 0.3)).cast_to_unstructured_grid()
HEXAHEDRA = pyvista.StructuredGrid(*np.meshgrid([0, 0.6, 1, 2], [0, 0.5, 1], [0, 1, 1.5], indexing="ij"))
PLANES = {
    "xy": np.eye(3)[:2], "xz": np.eye(3)[[0, 2]], "yz": np.eye(3)[[1, 2]], "zx": np.eye(3)[[2, 0]],
    "tilted": np.linalg.qr(np.array([[1.0, 2, 3], [0.5, -1, 0.2], [0, 1, 1]]))[0].T[:2],
}  # fmt: skip


def write(folder, frames, name="f"):
    """Write grids as frames and return the path of the index."""
    folder.mkdir(exist_ok=True)
    for k, grid in enumerate(frames):
        grid.save(folder / f"{name}_{k}.vtu")
    return write_pvd(folder, [(0.1 * k, f"{name}_{k}.vtu") for k in range(len(frames))])


def draw(blocks, points):
    """A grid of cells of VTK's kinds."""
    cells = [np.column_stack([np.full(len(rows), np.shape(rows)[1]), np.array(rows)]) for rows in blocks.values()]
    kinds = np.repeat(np.array([*blocks], dtype=np.uint8), [len(rows) for rows in blocks.values()])
    return pyvista.UnstructuredGrid(np.concatenate([c.ravel() for c in cells]), kinds, np.asarray(points, dtype=float))


def make(cells, points, kind=10, move=None, s=1.0, **cell_data):
    """A grid whose displacement stretches it, or with moved points."""
    points = np.asarray(points, dtype=float)
    grid = draw({kind: cells}, points if move is None else move(points))
    if move is None:
        grid.point_data["displacement"] = stretch(points, s) - points
    for name, values in cell_data.items():
        grid.cell_data[name] = values
    return grid


def displace(grid):
    """Frames of a grid with the displacement of each stretch."""
    frames = []
    for s in STRETCHES:
        frame = grid.copy()
        frame.points = np.asarray(grid.points, dtype=float)
        frame.point_data["displacement"] = stretch(frame.points, s) - frame.points
        frames.append(frame)
    return frames


# Kinds


def make_kinds():
    yield "voxels", IMAGE, 12
    hexahedra = HEXAHEDRA.cast_to_unstructured_grid()
    yield "hexahedra", hexahedra, 12
    x = TETRAHEDRA.points
    yield "tetrahedra", draw({10: TETRAHEDRA.cells}, x), len(TETRAHEDRA.cells)
    yield "Lagrange of order 1", draw({71: TETRAHEDRA.cells}, x), len(TETRAHEDRA.cells)
    wedge = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1.0]])
    yield "wedge", draw({13: [range(6)]}, wedge), 1
    pyramid = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1.0]])
    yield "pyramid", draw({14: [range(5)]}, pyramid), 1
    yield "triangles of Lagrange", draw({69: TRIANGLES.cells}, FLAT), len(TRIANGLES.cells)
    pixels = pyvista.ImageData(dimensions=(4, 3, 1)).cast_to_unstructured_grid()
    yield "pixels", pixels, 6
    corners = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0]]
    yield "triangle and quadrilateral", draw({5: [[0, 1, 4]], 9: [[1, 2, 3, 4]]}, corners), 2


@pytest.mark.parametrize(("grid", "count"), [pytest.param(g, c, id=n) for n, g, c in make_kinds()])
def test_every_kind_is_measured(tmp_path, grid, count):
    path = write(tmp_path, displace(grid))
    assert_stretched(path)
    series = read_series(path)
    assert len(series.mesh.rest_volumes) == count
    assert series.describe_decisions().left_out == ""
    areas = series.mesh.dimension == 2
    sizes = grid.compute_cell_sizes()["Area" if areas else "Volume"]
    assert series.mesh.rest_volumes == pytest.approx(np.abs(sizes), rel=1e-6)


@pytest.mark.parametrize(("kind", "count", "name"), [(1, 1, "vertex"), (3, 2, "line"), (21, 3, "quadratic edge")])
def test_cells_without_volume_alone_are_refused_with_a_remedy(tmp_path, kind, count, name):
    path = write(tmp_path, [make([range(count)], TETRAHEDRA.points[:count], kind) for _ in range(2)])
    with pytest.raises(SeriesError, match=f"1 {name}.* cannot be measured; write the solid or surface cells"):
        read_series(path)


def test_cells_of_a_refused_kind_are_left_out_with_their_share(tmp_path):
    hexahedron = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1.0]])
    points = np.vstack([TETRAHEDRA.points, hexahedron + np.array([5, 0, 0])])
    n = len(TETRAHEDRA.points)
    grid = draw({10: TETRAHEDRA.cells, 41: [range(n, n + 8)], 5: [[0, 1, 2]]}, points)
    series = read_series(write(tmp_path, displace(grid)))
    left_out = series.describe_decisions().left_out
    assert "1 cell that cannot be measured (about 33 % of the volume)" in left_out
    assert "1 cell of lower dimension (no volume)" in left_out
    assert any("1 convex point set" in note and "write polyhedra" in note for note in series.notes)


# Planes and surfaces


@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize("noise", [0, 1e-12, 1e-9, 1e-7])
@pytest.mark.parametrize("moving", [False, True])
def test_a_body_is_planar_in_any_plane(tmp_path, plane, noise, moving):
    rows = PLANES[plane]
    normal = np.cross(*rows)
    frames = []
    for s in STRETCHES:
        X = TRIANGLES.points @ rows + 0.3 + noise * RNG.uniform(-1, 1, (len(FLAT), 1)) * normal
        x = (TRIANGLES.points * [s, 1]) @ rows + 0.3
        frames.append(make(TRIANGLES.cells, x if moving else X, 5, move=np.asarray))
        if not moving:
            frames[-1].point_data["displacement"] = x - X
    series = read_series(write(tmp_path, frames))
    for frame, s in zip(series, STRETCHES, strict=True):
        values = measure(frame)
        assert values["volume_ratio"] == pytest.approx(s, rel=1e-5)
        assert values["rotation_angle"] == pytest.approx(0, abs=1e-3)
    assert series.mesh.dimension == 2 and not any("surface" in note for note in series.notes)


@pytest.mark.parametrize("plane", PLANES)
def test_an_inverted_cell_in_any_plane_is_negative(tmp_path, plane):
    X = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    x = X.copy()
    x[2] = [-0.2, -0.2]
    frames = [make([[0, 1, 2], [0, 2, 3]], p @ PLANES[plane], 5, move=np.asarray) for p in (X, x)]
    last = ratios(write(tmp_path, frames))[1]
    assert (last < 0).all()


def lift(points, height):
    return points + np.array([[0, 0, 1.0]]) * (height * points[:, :1] ** 2)


def test_a_plate_that_leaves_its_plane_is_a_surface(tmp_path):
    frames = [make(TRIANGLES.cells, FLAT, 5, move=lambda p, k=k: lift(p, 0.3 * k)) for k in range(3)]
    series = read_series(write(tmp_path, frames))
    assert any("leaves its plane" in note for note in series.notes)
    last = measure(series.read_frame(2))["volume_ratio"]
    areas = [frame.compute_cell_sizes()["Area"] for frame in frames]
    assert last == pytest.approx(areas[2] / areas[0], rel=1e-12) and last.min() > 1 - 1e-12


def test_a_plate_that_leaves_its_plane_in_a_frame_not_looked_at_has_no_numbers_there(tmp_path):
    frames = [make(TRIANGLES.cells, FLAT, 5, move=lambda p, k=k: p * [1 + 0.01 * k, 1, 1] + [0, 0, k == 41] * p[:, :1])
              for k in range(80)]  # fmt: skip
    series = read_series(write(tmp_path, frames))
    assert measure(series.read_frame(40))["volume_ratio"] == pytest.approx(1.4)
    frame = series.read_frame(41)
    assert np.isnan(measure(frame)["volume_ratio"]).all() and "leaves its plane" in frame.fault


# Orientation


def mirror(cells, which):
    mirrored = cells.copy()
    mirrored[which, -2:] = mirrored[which, -2:][:, ::-1]
    return mirrored


def make_orientations():
    everything = np.ones(len(TETRAHEDRA.cells), dtype=bool)
    some = RNG.random(len(TETRAHEDRA.cells)) < 0.4
    x = TETRAHEDRA.points
    yield "all", x, mirror(TETRAHEDRA.cells, everything), 10
    yield "some", x, mirror(TETRAHEDRA.cells, some), 10
    yield "sorted", x, np.sort(TETRAHEDRA.cells, axis=1), 10
    one = np.arange(len(TETRAHEDRA.cells)) == 7
    yield "one", x, mirror(TETRAHEDRA.cells, one), 10
    own = x[mirror(TETRAHEDRA.cells, some)].reshape(-1, 3)
    yield "own points", own, np.arange(len(own)).reshape(-1, 4), 10
    yield "only cell", x[TETRAHEDRA.cells[0]], mirror(np.arange(4)[None], np.array([True])), 10
    yield "sorted triangles", FLAT, np.sort(TRIANGLES.cells, axis=1), 5
    in_xz = TRIANGLES.points @ PLANES["xz"]
    yield "triangles in xz", in_xz, np.sort(TRIANGLES.cells, axis=1), 5
    hexahedra = HEXAHEDRA.cast_to_unstructured_grid()
    cells = hexahedra.cells.reshape(-1, 9)[:, 1:]
    swapped = cells.copy()
    swapped[::2] = swapped[::2][:, [4, 5, 6, 7, 0, 1, 2, 3]]
    yield "half of the hexahedra", hexahedra.points, swapped, 12
    quads = pyvista.ImageData(dimensions=(4, 3, 1)).cast_to_unstructured_grid()
    around = quads.cells.reshape(-1, 5)[:, [1, 2, 4, 3]].copy()
    around[1::2] = around[1::2][:, ::-1]
    yield "half of the quadrilaterals", quads.points, around, 9


@pytest.mark.parametrize(
    ("points", "cells", "kind"), [pytest.param(p, c, k, id=n) for n, p, c, k in make_orientations()]
)
def test_cells_that_are_only_numbered_mirrored_are_reoriented(tmp_path, points, cells, kind):
    path = write(tmp_path, [make(cells, points, kind, s=s) for s in STRETCHES])
    assert_stretched(path)
    series = read_series(path)
    assert (series.mesh.rest_volumes > 0).all() and any("mirrored" in note for note in series.notes)
    back = write(tmp_path / "back", [make(cells, points, kind), make(cells, points, kind, s=-1.0)])
    assert (ratios(back, displacement="displacement")[1] < 0).all()  # an inversion after rest is none of numbering


def test_half_of_the_polygons_may_run_the_other_way(tmp_path):
    points = FLAT
    faces = []
    for k, cell in enumerate(TRIANGLES.cells):
        faces += [3, *(cell if k % 2 else cell[::-1])]
    grid = pyvista.UnstructuredGrid(np.array(faces), np.full(len(TRIANGLES.cells), 7, dtype=np.uint8), points)
    assert_stretched(write(tmp_path, displace(grid)))


def test_cells_folded_at_rest_are_named(tmp_path):
    points = TETRAHEDRA.points.copy()
    inner = int(np.argmin(np.linalg.norm(points - [0.7, 0.5, 0.5], axis=1)))
    points[inner] += [1.3, 0, 0]  # through the cells beside it
    grid = make(TETRAHEDRA.cells, points)
    with pytest.raises(SeriesError, match=r"rest state: \d+ inverted cells, [\d, ]+.*folded.*rest = FILE"):
        read_series(write(tmp_path / "a", [grid, grid]))
    mixed = make(np.sort(TETRAHEDRA.cells, axis=1), points)
    with pytest.raises(SeriesError, match="folded"):
        read_series(write(tmp_path / "b", [mixed, mixed]))
    rest = tmp_path / "rest.vtu"
    make(TETRAHEDRA.cells, TETRAHEDRA.points).save(rest)
    moved = [make(TETRAHEDRA.cells, points, move=np.asarray)] * 2
    assert ratios(write(tmp_path / "c", moved), rest=rest)[0].min() < 0


# Copies, ghosts, parts, flat cells


def test_cells_that_are_there_twice_count_once(tmp_path):
    twice = np.vstack([TETRAHEDRA.cells, TETRAHEDRA.cells[3:7][:, [1, 0, 3, 2]]])
    path = write(tmp_path, [make(twice, TETRAHEDRA.points, s=s) for s in STRETCHES])
    series = read_series(path)
    assert any("4 cells are there twice" in note for note in series.notes)
    assert [float(measure(frame)["total_volume"]) for frame in series] == pytest.approx([2 * s for s in STRETCHES])


@pytest.mark.parametrize(
    ("name", "marks"),
    [("vtkGhostType", (0, 1)), ("vtkGhostType", (0, 32)), ("ghostRank", (-1, 3)), ("ghostRank", (-2, 0)),
     ("vtkGhostLevels", (0, 1)), ("GhostType", (0, 1)), ("is_ghost", (0, 1)), ("GhostLevel", (0, 2))],
)  # fmt: skip
def test_ghost_cells_are_left_out(tmp_path, name, marks):
    ghost = np.arange(len(TETRAHEDRA.cells)) % 5 == 0
    values = np.where(ghost, marks[1], marks[0]).astype(np.uint8 if "vtk" in name else np.int32)
    grids = []
    for s in STRETCHES:
        grids.append(make(TETRAHEDRA.cells, TETRAHEDRA.points, s=s, ghosts=values))
        grids[-1].cell_data[name] = grids[-1].cell_data.pop("ghosts")
    series = read_series(write(tmp_path, grids))
    assert len(series.mesh.rest_volumes) == (~ghost).sum()
    assert_stretched(tmp_path / "their.pvd")


@pytest.mark.parametrize("name", ["ghostRank", "GhostType", "is_ghost"])
def test_marks_that_are_the_same_everywhere_mark_nothing(tmp_path, name):
    grids = []
    for s in STRETCHES:
        grids.append(make(TETRAHEDRA.cells, TETRAHEDRA.points, s=s))
        grids[-1].cell_data[name] = np.ones(len(TETRAHEDRA.cells), dtype=np.int32)
    assert len(read_series(write(tmp_path, grids)).mesh.rest_volumes) == len(TETRAHEDRA.cells)


def write_parts(folder, pieces):
    """Write pieces of (points, cells) as two parts a time; points of all are stretched."""
    folder.mkdir(exist_ok=True)
    rows = []
    for k, s in enumerate(STRETCHES):
        for r, (points, cells) in enumerate(pieces):
            make(cells, points, s=s).save(folder / f"f_{k}_{r}.vtu")
            rows.append(f'<DataSet timestep="{0.1 * k}" part="{r}" file="f_{k}_{r}.vtu"/>')
    path = folder / "s.pvd"
    text = "".join(rows)
    path.write_text(f'<VTKFile type="Collection" version="0.1"><Collection>{text}</Collection></VTKFile>')
    return path


def split(cells):
    used, local = np.unique(cells, return_inverse=True)
    return TETRAHEDRA.points[used], local.reshape(cells.shape)


def test_points_of_parts_that_coincide_are_one_node(tmp_path):
    half = len(TETRAHEDRA.cells) // 2
    pieces = [split(TETRAHEDRA.cells[:half]), split(TETRAHEDRA.cells[half:])]
    shifted = (pieces[1][0] + 1e-13 * RNG.uniform(-1, 1, pieces[1][0].shape), pieces[1][1])
    for name, second in (("exact", pieces[1]), ("rounded", shifted)):
        series = read_series(write_parts(tmp_path / name, [pieces[0], second]))
        assert len(series.mesh.points) == len(TETRAHEDRA.points)
        assert len(series.mesh.rest_volumes) == len(TETRAHEDRA.cells)
        assert_stretched(tmp_path / name / "s.pvd")
    overlapping = [split(TETRAHEDRA.cells[: half + 6]), split(TETRAHEDRA.cells[half - 6 :])]
    series = read_series(write_parts(tmp_path / "overlap", overlapping))
    assert len(series.mesh.rest_volumes) == len(TETRAHEDRA.cells)
    assert [float(measure(frame)["total_volume"]) for frame in series] == pytest.approx([2 * s for s in STRETCHES])


def test_cells_with_points_of_their_own_stay_apart_in_parts(tmp_path):
    half = len(TETRAHEDRA.cells) // 2
    pieces = []
    for cells in (TETRAHEDRA.cells[:half], TETRAHEDRA.cells[half:]):
        pieces.append((TETRAHEDRA.points[cells].reshape(-1, 3), np.arange(4 * len(cells)).reshape(-1, 4)))
    path = write_parts(tmp_path, pieces)
    assert_stretched(path)
    assert len(read_series(path).mesh.points) > len(TETRAHEDRA.cells)


def test_few_flat_cells_do_not_end_the_analysis(tmp_path):
    points = np.vstack([TETRAHEDRA.points, [[2.5, 0, 0], [2.5, 1, 0], [2.5, 0.5, 0], [2.5, 0.25, 0]]])
    n = len(TETRAHEDRA.points)
    cells = np.vstack([TETRAHEDRA.cells, [[n, n + 1, n + 2, n + 3]]])
    path = write(tmp_path, [make(cells, points, s=s) for s in STRETCHES])
    assert_stretched(path)
    series = read_series(path)
    assert len(series.mesh.rest_volumes) == len(TETRAHEDRA.cells)
    assert "1 cell that are flat" in series.describe_decisions().left_out


def test_thin_cells_are_no_flat_cells(tmp_path):
    thin = TETRAHEDRA.points * [1, 1, 1e-7]
    assert_stretched(write(tmp_path, [make(TETRAHEDRA.cells, thin, s=s) for s in STRETCHES]), rtol=1e-6)
    assert len(read_series(tmp_path / "their.pvd").mesh.rest_volumes) == len(TETRAHEDRA.cells)


# Frames


def bend(points, k):
    return points + 0.1 * k * np.column_stack([points[:, 1] ** 2, points[:, 0] * points[:, 2], points[:, 0]])


ID_NAMES = [
    ("GlobalNodeId", "GlobalElementId"), ("vtkOriginalPointIds", "vtkOriginalCellIds"), ("node_ids", "element_ids"),
    ("localToGlobalMap", "localToGlobalMap"), ("PedigreeNodeId", "PedigreeElementId"), ("NodeId", "ElementId"),
    ("ids", "ids"), (None, "cell_ids"), ("GlobalNodeId", None),
]  # fmt: skip


@pytest.mark.parametrize(("node_name", "cell_name"), ID_NAMES)
@pytest.mark.parametrize("mirrored", [False, True])
def test_moving_cells_in_another_order_are_followed_by_ids(tmp_path, node_name, cell_name, mirrored):
    cells = np.sort(TETRAHEDRA.cells, axis=1) if mirrored else TETRAHEDRA.cells
    plain = [make(cells, TETRAHEDRA.points, move=lambda p, k=k: bend(p, k)) for k in range(3)]
    frames = []
    for k, grid in enumerate(plain):
        nodes = np.arange(grid.n_points) if k != 1 else RNG.permutation(grid.n_points)
        order = np.arange(grid.n_cells) if k != 1 else RNG.permutation(grid.n_cells)
        place = np.argsort(nodes)
        frames.append(draw({10: place[cells[order]]}, grid.points[nodes]))
        if node_name:
            frames[-1].point_data[node_name] = 10 * nodes + 3
        if cell_name:
            frames[-1].cell_data[cell_name] = 7 * order + 1
    expected = ratios(write(tmp_path / "plain", plain))
    for a, b in zip(ratios(write(tmp_path / "s", frames)), expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)


def test_ids_that_are_only_counted_do_not_mislead(tmp_path):
    """Every frame numbers its own points from 0, though cells come in another order: rest positions match them."""
    frames = []
    for k, s in enumerate(STRETCHES):
        order = np.roll(np.arange(len(TETRAHEDRA.cells)), 5 * k)
        X = TETRAHEDRA.points[TETRAHEDRA.cells[order]].reshape(-1, 3)
        grid = make(np.arange(len(X)).reshape(-1, 4), X, s=1.0)
        grid.point_data["displacement"] = bend(X, s - 1) - X
        grid.point_data["ids"] = np.arange(len(X))
        frames.append(grid)
    series = read_series(write(tmp_path, frames))
    assert measure(series.read_frame(0))["volume_ratio"] == pytest.approx(1)
    plain = [make(TETRAHEDRA.cells, TETRAHEDRA.points, move=lambda p, s=s: bend(p, s - 1)) for s in STRETCHES]
    for a, b in zip(series, ratios(write(tmp_path / "plain", plain)), strict=True):
        np.testing.assert_allclose(measure(a)["volume_ratio"], b, rtol=1e-9)


def test_moving_cells_with_points_of_their_own_in_another_order_have_no_numbers(tmp_path):
    """Neither ids nor a displacement tell the order, but cells that were neighbors have parted."""
    frames, torn = [], []
    for k in range(3):
        order = np.roll(np.arange(len(TETRAHEDRA.cells)), 7 if k == 1 else 0)
        x = bend(TETRAHEDRA.points, k)[TETRAHEDRA.cells[order]].reshape(-1, 3)
        frames.append(draw({10: np.arange(len(x)).reshape(-1, 4)}, x))
        own = TETRAHEDRA.points[TETRAHEDRA.cells] + 0.1 * k * TETRAHEDRA.centers[:, None]
        torn.append(draw({10: np.arange(len(x)).reshape(-1, 4)}, own.reshape(-1, 3)))
    series = read_series(write(tmp_path / "moved", frames))
    assert np.isnan(measure(series.read_frame(1))["volume_ratio"]).all()
    assert "another order" in series.read_frame(1).fault and not series.read_frame(2).fault
    assert np.isfinite(measure(series.read_frame(1))["total_volume"])
    for ratio in ratios(write(tmp_path / "torn", torn)):  # a body that really comes apart
        assert ratio == pytest.approx(1)


def test_copies_of_cells_do_not_stand_for_them(tmp_path):
    """A ghost copy holds an old displacement; frames come in other orders."""
    X, cells = TETRAHEDRA.points[TETRAHEDRA.cells].reshape(-1, 3), np.arange(TETRAHEDRA.cells.size).reshape(-1, 4)
    frames = []
    for k, s in enumerate(STRETCHES):
        order = np.roll(np.arange(len(cells)), 5 * k)
        x = np.vstack([X[cells[:4]].reshape(-1, 3), X[cells[order]].reshape(-1, 3)])
        u = stretch(x, s) - x
        u[:16] = 0
        grid = draw({10: np.arange(len(x)).reshape(-1, 4)}, x)
        grid.point_data["displacement"] = u
        grid.cell_data["vtkGhostType"] = (np.arange(len(x) // 4) < 4).astype(np.uint8)
        frames.append(grid)
    assert_stretched(write(tmp_path, frames))


def test_some_points_that_are_not_finite_end_only_their_cells(tmp_path):
    frames = [make(TETRAHEDRA.cells, TETRAHEDRA.points, s=s) for s in STRETCHES]
    frames[2].point_data["displacement"][4] = np.inf
    series = read_series(write(tmp_path, frames))
    frame = series.read_frame(2)
    has = (series.mesh.cells == 4).any(axis=1)
    values = measure(frame)["volume_ratio"]
    assert np.isnan(values[has]).all() and values[~has] == pytest.approx(1.5)
    assert frame.fault == "1 points are not finite, first 4"


@pytest.mark.parametrize("kind", ["tetrahedra", "hexahedra", "triangles", "triangles in xz", "surface"])
def test_a_changed_mesh_keeps_the_numbers_of_the_whole(tmp_path, kind):
    def draw(n, s):
        if kind == "tetrahedra":
            mesh = box([2.0, 1.0, 1.0], [n, 1, 1])
            return make(np.sort(mesh.cells, axis=1), mesh.points, move=lambda p: stretch(p, s))
        if kind == "hexahedra":
            return pyvista.ImageData(dimensions=(n + 1, 2, 2), spacing=(2 * s / n, 1, 1)).cast_to_unstructured_grid()
        mesh = rectangle([2.0, 1.0], [n, 1])
        rows = PLANES["xz" if kind == "triangles in xz" else "xy"]
        points = mesh.points @ rows
        if kind == "surface":
            points[:, 2] = 0.5 * points[:, 1] ** 2
        return make(mesh.cells, points, 5, move=lambda p: stretch(p, s))

    frames = [draw(2, 1.0), draw(2, 1.1), draw(3, 1.2)]
    path = write(tmp_path, frames)
    series = read_series(path)
    values = [measure(frame) for frame in series]
    total = [float(v["total_volume"]) for v in values]
    assert [t / total[0] for t in total] == pytest.approx([1, 1.1, 1.2], rel=1e-6)
    assert values[2]["volume_drift"] == pytest.approx(0.2, rel=1e-6)
    assert np.isnan(values[2]["volume_ratio"]).all() and "topology changes" in series.read_frame(2).fault
    assert values[2]["center_of_mass"] == pytest.approx(values[0]["center_of_mass"] * [1.2, 1, 1], rel=1e-6)


def test_eroded_cells_leave_the_whole_body(tmp_path):
    frames = [make(TETRAHEDRA.cells[: len(TETRAHEDRA.cells) - 6 * k], TETRAHEDRA.points, s=1.0) for k in range(3)]
    series = read_series(write(tmp_path, frames))
    totals = [float(measure(frame)["total_volume"]) for frame in series]
    assert totals == pytest.approx([2, 2 - 6 / 36, 2 - 12 / 36])


@pytest.mark.parametrize("moving", [False, True])
def test_the_displacement_of_eroded_cells_counts(tmp_path, moving):
    frames = []
    for k, s in enumerate(STRETCHES):
        grid = make(TETRAHEDRA.cells[: len(TETRAHEDRA.cells) - 6 * k], TETRAHEDRA.points, s=s)
        if moving:
            grid.points = stretch(TETRAHEDRA.points, s)
        frames.append(grid)
    series = read_series(write(tmp_path, frames))
    totals = [float(measure(frame)["total_volume"]) for frame in series]
    assert totals == pytest.approx([(2 - k * 6 / 36) * s for k, s in enumerate(STRETCHES)])


def test_a_displacement_of_frames_with_other_points_is_asked_about(tmp_path):
    meshes = [box([2.0, 1.0, 1.0], [n, 1, 1]) for n in (2, 3, 4)]
    frames = [make(mesh.cells, mesh.points, s=s) for mesh, s in zip(meshes, STRETCHES, strict=False)]
    with pytest.raises(SeriesError, match=r"no other has its cells.*displacement"):
        read_series(write(tmp_path, frames))
    totals = [float(measure(frame)["total_volume"]) for frame in read_series(tmp_path, displacement="displacement")]
    assert totals == pytest.approx([2 * s for s in STRETCHES[:3]])


@pytest.mark.parametrize("kind", ["deformed", "rest"])
def test_the_command_counts_a_displacement_once(tmp_path, kind, capsys):
    """A frame of deformed points with a displacement, and the file of the rest state."""
    X = TETRAHEDRA.points
    make(TETRAHEDRA.cells, X).save(tmp_path / "b_0.vtk")
    last = make(TETRAHEDRA.cells, X, s=1.5)
    last.points = stretch(X, 1.5) if kind == "deformed" else X
    last.save(tmp_path / "b_last.vtk")
    arguments = ["analyze", str(tmp_path / "b_last.vtk"), "--rest", str(tmp_path / "b_0.vtk")]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
    assert "worst volume ratio 1.5000" in capsys.readouterr().out
    assert main([*arguments[:2], "--out", str(tmp_path / "out")]) == 2


@pytest.mark.parametrize(
    ("shift", "dtype", "noted"),
    [((451234.3, 5712345.7, 0), np.float32, True), ((451234.3, 5712345.7, 0), np.float64, False),
     ((450000, 5700000, 0), np.float64, False), ((0, 0, 0), np.float32, False), ((1000.1, 0, 0), np.float32, True)],
)  # fmt: skip
def test_coarse_numbers_are_noted(tmp_path, shift, dtype, noted):
    frames = []
    for s in (1.0, 1.1, 1.2):
        points = (stretch(TETRAHEDRA.points, s) + shift).astype(dtype)
        frames.append(pyvista.UnstructuredGrid({10: TETRAHEDRA.cells}, points))
    series = read_series(write(tmp_path, frames))
    assert any("single precision" in note for note in series.notes) == noted
