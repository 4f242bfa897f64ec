"""Series written by other programs: every format, the guesses about them, and the refusals."""

import json
import pickle
import re
import shutil
import subprocess
import sys

import meshio
import numpy as np
import pytest
import pyvista
import vtk
import xarray

from pipeline.errors import SeriesError
from pipeline.mesh.simplex import Mesh
from pipeline.run.measures import measure
from pipeline.series import read_series
from pipeline.series import xarray_plugin as engine
from pipeline.series.dataset.writer import write_pvd_series
from pipeline.series.files.frame_files import read_grid
from tests.bodies import assert_conventional

TIMES = [0.0, 0.1, 0.25]
GROWTH = 0.5  # of every length per second: the volume ratio is (1 + t / 2)^3


def unit_mesh() -> tuple[np.ndarray, np.ndarray]:
    grid = pyvista.ImageData(dimensions=(3, 3, 3)).cast_to_unstructured_grid().triangulate()
    points, cells = np.array(grid.points, dtype=float), np.array(grid.cells_dict[10], dtype=np.int64)
    edges = np.swapaxes(points[cells[:, 1:]] - points[cells[:, :1]], 1, 2)
    cells[np.linalg.det(edges) < 0] = cells[np.linalg.det(edges) < 0][:, [0, 1, 3, 2]]
    return points, cells


POINTS, CELLS = unit_mesh()


def move_points(t: float) -> np.ndarray:
    return POINTS * (1 + GROWTH * t)


def make_grid(t: float, *, field: str | None = None, points=None, numbers=False) -> pyvista.UnstructuredGrid:
    grid = pyvista.UnstructuredGrid({10: CELLS}, POINTS if field else move_points(t) if points is None else points)
    if numbers:
        grid.point_data["speed"] = np.linspace(0, 1, len(POINTS))
    if field:
        grid.point_data[field] = move_points(t) - POINTS
    return grid


def write_pvd(folder, rows):
    lines = "".join(f'<DataSet timestep="{t!r}" file="{name}"/>' for t, name in rows)
    path = folder / "their.pvd"
    path.write_text(f'<VTKFile type="Collection"><Collection>{lines}</Collection></VTKFile>')
    return path


def write_series(folder, **options):
    for i, t in enumerate(TIMES):
        make_grid(t, **options).save(folder / f"f{i}.vtu")
    return write_pvd(folder, [(t, f"f{i}.vtu") for i, t in enumerate(TIMES)])


def assert_grows(series, *, rtol=1e-12, times=TIMES):
    assert series.times == pytest.approx(times)
    for t, frame in zip(times, series, strict=True):
        assert frame.mesh is series.mesh and frame.time == pytest.approx(t)
        assert measure(frame)["volume_ratio"] == pytest.approx(np.full(len(CELLS), (1 + GROWTH * t) ** 3), rel=rtol)


# Formats


@pytest.mark.parametrize("style", ["ascii", "zlib", "lz4", "big-endian", "raw appended", "float32", "int32 ids"])
def test_read_every_encoding_of_vtu_that_vtk_writes(tmp_path, style):
    for i, t in enumerate(TIMES):
        grid = make_grid(t, points=move_points(t).astype(np.float32) if style == "float32" else None)
        writer = vtk.vtkXMLUnstructuredGridWriter()
        writer.SetFileName(str(tmp_path / f"f{i}.vtu"))
        writer.SetInputData(grid)
        if style == "ascii":
            writer.SetDataModeToAscii()
        elif style == "raw appended":
            writer.SetDataModeToAppended()
            writer.EncodeAppendedDataOff()
        else:
            writer.SetDataModeToBinary()
        writer.SetCompressorTypeToLZ4() if style == "lz4" else writer.SetCompressorTypeToZLib()
        if style == "big-endian":
            writer.SetByteOrderToBigEndian()
        if style == "int32 ids":
            writer.SetIdTypeToInt32()
        assert writer.Write()
    assert_grows(read_series(write_pvd(tmp_path, [(t, f"f{i}.vtu") for i, t in enumerate(TIMES)])),
                 rtol=1e-5 if style == "float32" else 1e-9)  # fmt: skip


@pytest.mark.parametrize("suffix", ["vtu", "vtk"])
@pytest.mark.parametrize("binary", [True, False])
def test_read_numbered_files_of_meshio(tmp_path, suffix, binary):
    for i, t in enumerate(TIMES):
        mesh = meshio.Mesh(move_points(t), [("tetra", CELLS)])
        meshio.write(tmp_path / f"beam_{i}.{suffix}", mesh, binary=binary)
    series = read_series(str(tmp_path / "beam_*"))
    assert series.times == (0.0, 1.0, 2.0) and "counted from 0" in series.notes[0]
    assert measure(series.read_frame(2))["volume_ratio"] == pytest.approx((1 + GROWTH * TIMES[2]) ** 3)


def test_numbers_sort_naturally_and_times_come_from_the_files(tmp_path):
    for i in range(12):
        grid = make_grid(i / 4)
        grid.field_data["TimeValue"] = [i / 4]
        grid.save(tmp_path / f"f{i}.vtu")
    assert_grows(read_series(tmp_path), times=[i / 4 for i in range(12)])


def test_read_legacy_files_with_time_values(tmp_path):
    for i, t in enumerate(TIMES):
        grid = make_grid(t)
        grid.field_data["TimeValue"] = [t]
        grid.save(tmp_path / f"f{i}.vtk", binary=bool(i % 2))
    assert_grows(read_series(tmp_path))


def test_read_a_json_index(tmp_path):
    write_series(tmp_path)
    index = tmp_path / "their.vtu.series"
    files = [{"name": f"f{i}.vtu", "time": t} for i, t in enumerate(TIMES)]
    index.write_text(json.dumps({"file-series-version": "1.0", "files": files}))
    assert_grows(read_series(index))


def test_pieces_of_a_pvtu_form_one_frame(tmp_path):
    for i, t in enumerate(TIMES):
        writer = vtk.vtkXMLPUnstructuredGridWriter()
        writer.SetFileName(str(tmp_path / f"p{i}.pvtu"))
        pieces = [make_grid(t).extract_cells(part) for part in np.array_split(np.arange(len(CELLS)), 2)]
        for k, piece in enumerate(pieces):
            piece.save(tmp_path / f"p{i}_{k}.vtu")
        sources = "".join(f'<Piece Source="p{i}_{k}.vtu"/>' for k in range(2))
        (tmp_path / f"p{i}.pvtu").write_text(
            '<VTKFile type="PUnstructuredGrid" version="0.1"><PUnstructuredGrid GhostLevel="0"><PPoints>'
            f'<PDataArray type="Float64" Name="Points" NumberOfComponents="3"/></PPoints>{sources}'
            "</PUnstructuredGrid></VTKFile>"
        )
    series = read_series(write_pvd(tmp_path, [(t, f"p{i}.pvtu") for i, t in enumerate(TIMES)]))
    assert_grows(series)
    assert len(series.mesh.cells) == len(CELLS)
    assert len(read_series(tmp_path / "p*.pvtu")) == 3


def test_read_temporal_vtkhdf(tmp_path):
    path = tmp_path / "steps.vtkhdf"
    write_vtkhdf(path)
    assert_grows(read_series(path))


def write_vtkhdf(path):
    from vtkmodules.util.vtkAlgorithm import VTKPythonAlgorithmBase

    class Source(VTKPythonAlgorithmBase):
        def __init__(self):
            super().__init__(nInputPorts=0, nOutputPorts=1, outputType="vtkUnstructuredGrid")

        def RequestInformation(self, _request, _inputs, outputs):
            information = outputs.GetInformationObject(0)
            key = vtk.vtkStreamingDemandDrivenPipeline
            information.Set(key.TIME_STEPS(), TIMES, len(TIMES))
            information.Set(key.TIME_RANGE(), [TIMES[0], TIMES[-1]], 2)
            return 1

        def RequestData(self, _request, _inputs, outputs):
            information = outputs.GetInformationObject(0)
            key = vtk.vtkStreamingDemandDrivenPipeline.UPDATE_TIME_STEP()
            t = information.Get(key) if information.Has(key) else TIMES[0]
            output = information.Get(vtk.vtkDataObject.DATA_OBJECT())
            output.ShallowCopy(make_grid(t))
            output.GetInformation().Set(vtk.vtkDataObject.DATA_TIME_STEP(), t)
            return 1

    source = Source()
    writer = vtk.vtkHDFWriter()
    writer.SetInputConnection(source.GetOutputPort())
    writer.SetFileName(str(path))
    writer.SetWriteAllTimeSteps(True)
    writer.Write()


def write_xdmf(path, data_format="XML"):
    with meshio.xdmf.TimeSeriesWriter(path, data_format=data_format) as writer:
        writer.write_points_cells(POINTS, [("tetra", CELLS)])
        for t in TIMES:
            writer.write_data(t, point_data={"u": move_points(t) - POINTS})
    return path


def test_read_xdmf(tmp_path):
    series = read_series(write_xdmf(tmp_path / "a.xdmf"))
    assert_grows(series)
    assert any("u is taken" in note for note in series.notes)


def test_xdmf_with_hdf5_names_the_missing_package(tmp_path, in_process, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)  # as if it were not installed
    path = write_xdmf(tmp_path / "a.xdmf")
    text = path.read_text().replace('Format="XML"', 'Format="HDF"')
    path.write_text(re.sub(r"(<DataItem[^>]*>)[^<]*<", r"\1a.h5:/data0<", text))
    with pytest.raises(SeriesError, match="pip install h5py"):
        read_series(path)


def test_triangles_in_a_plane_are_two_dimensional(tmp_path):
    points, cells = np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1.0]]), np.array([[0, 1, 2], [0, 2, 3]])
    for i, t in enumerate(TIMES):
        meshio.write(tmp_path / f"f{i}.vtu", meshio.Mesh(points * [1 + t, 1, 1], [("triangle", cells)]))
    series = read_series(tmp_path)
    assert series.mesh.dimension == 2
    assert measure(series.read_frame(1))["volume_ratio"] == pytest.approx([1.1, 1.1])


# Guesses


def test_a_displacement_field_is_added_to_points_that_do_not_move(tmp_path):
    path = write_series(tmp_path, field="Displacement")
    series = read_series(path)
    assert_grows(series)
    assert any("Displacement is taken as the displacement" in note for note in series.notes)
    assert_grows(read_series(path, displacement="Displacement"))
    still = read_series(path, displacement="none")
    assert measure(still.read_frame(2))["volume_ratio"] == pytest.approx(1.0)


def test_points_that_move_only_between_the_first_the_middle_and_the_last_frame_are_found(tmp_path):
    times = [0.0, 1.0, 2.0, 3.0, 4.0]
    for i in range(5):
        grid = make_grid(i % 2)
        grid.point_data["displacement"] = move_points(i % 2) - POINTS
        grid.save(tmp_path / f"f{i}.vtu")
    path = write_pvd(tmp_path, [(t, f"f{i}.vtu") for i, t in enumerate(times)])
    for options in ({}, {"displacement": "none"}, {"displacement": "displacement"}):
        ratios = [measure(frame)["volume_ratio_mean"] for frame in read_series(path, **options)]
        assert ratios == pytest.approx([1, 1.5**3, 1, 1.5**3, 1])


def test_an_ambiguous_displacement_must_be_named(tmp_path):
    for i, t in enumerate(TIMES):
        grid = make_grid(t, field="u_h")
        grid.point_data["strange"] = 2 * (move_points(t) - POINTS)
        grid.point_data["velocity"] = move_points(t)
        grid.save(tmp_path / f"f{i}.vtu")
    path = write_pvd(tmp_path, [(t, f"f{i}.vtu") for i, t in enumerate(TIMES)])
    with pytest.raises(SeriesError, match=r"strange, u_h: say which"):
        read_series(path)
    assert_grows(read_series(path, displacement="u_h"))
    with pytest.raises(SeriesError, match=r"no point field w; it has strange, u_h, velocity"):
        read_series(path, displacement="w")


def test_sources_of_the_rest_state(tmp_path):
    rest = tmp_path / "rest.vtu"
    make_grid(0).save(rest)
    for i, t in enumerate(TIMES[1:]):
        grid = make_grid(t)
        grid.point_data["rest_position"] = POINTS * 2
        grid.save(tmp_path / f"f{i}.vtu")
    path = write_pvd(tmp_path, [(t, f"f{i}.vtu") for i, t in enumerate(TIMES[1:])])

    def first_ratio(**options):
        return measure(read_series(path, **options).read_frame(0))["volume_ratio_mean"]

    grown = (1 + GROWTH * TIMES[1]) ** 3
    assert first_ratio() == pytest.approx(grown / 8)
    assert first_ratio(rest="first") == pytest.approx(1)
    assert first_ratio(rest=rest) == pytest.approx(grown)
    with pytest.raises(SeriesError, match="a file"):
        read_series(path, rest="nonsense")


def test_cells_of_lower_dimension_are_counted_and_all_others_measured(tmp_path):
    hexahedron = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1.0]])
    n = len(POINTS)
    cells = [("hexahedron", [range(n, n + 8)]), ("tetra", CELLS), ("triangle", [[0, 1, 2]]), ("line", [[0, 1], [1, 2]])]
    for i, t in enumerate(TIMES):
        points = np.vstack([move_points(t), 9 + hexahedron * (1 + t), [[50, 50, 50]]])
        meshio.write(tmp_path / f"f{i}.vtu", meshio.Mesh(points, cells))
    series = read_series(write_pvd(tmp_path, [(t, f"f{i}.vtu") for i, t in enumerate(TIMES)]))
    ratio = measure(series.read_frame(2))["volume_ratio"]
    assert ratio[0] == pytest.approx(1.25**3) and ratio[1:] == pytest.approx((1 + GROWTH * 0.25) ** 3)
    assert any("no volume): 2 line, 1 triangle" in note for note in series.notes), series.notes
    assert any("1 points that belong to no measured cell" in note for note in series.notes)
    assert f"{len(CELLS)} tetrahedra and 1 hexahedron in 3D" == series.describe_decisions().cells
    for i, t in enumerate(TIMES):
        meshio.write(tmp_path / f"f{i}.vtu", meshio.Mesh(hexahedron * (1 + t), [("line", [[0, 1], [1, 2]])]))
    with pytest.raises(SeriesError, match="no cells with a volume or an area, but 2 line"):
        read_series(tmp_path / "their.pvd")


def test_rest_position_settles_every_guess(tmp_path, monkeypatch):
    for i, t in enumerate(TIMES):
        grid = make_grid(t)
        grid.point_data["rest_position"] = POINTS
        grid.save(tmp_path / f"f{i}.vtu")
    path = write_pvd(tmp_path, [(t, f"f{i}.vtu") for i, t in enumerate(TIMES)])
    shutil.copy(path, tmp_path / "series.pvd")
    series = read_series(tmp_path)
    assert series.notes == () and series.name == tmp_path.name
    assert_grows(series)


# Damage


@pytest.mark.parametrize("suffix", ["vtu", "vtk"])
@pytest.mark.parametrize("damage", ["missing", "empty", 0.2, 0.5, 0.97])
def test_a_damaged_frame_is_left_out_with_a_note(tmp_path, suffix, damage, vtk_errors):
    for i, t in enumerate(TIMES):
        make_grid(t, numbers=True).save(tmp_path / f"f{i}.{suffix}")
    path = write_pvd(tmp_path, [(t, f"f{i}.{suffix}") for i, t in enumerate(TIMES)])
    broken = tmp_path / f"f1.{suffix}"
    content = broken.read_bytes()
    if damage == "missing":
        broken.unlink()
    else:
        broken.write_bytes(b"" if damage == "empty" else content[: int(len(content) * damage)])
    series = read_series(path)
    assert_grows(series, times=[TIMES[0], TIMES[2]])
    assert f"left out: f1.{suffix} at t = 0.1 s" in series.notes[0]
    with pytest.raises(SeriesError, match=r"1 frames cannot be read, first f1"):
        read_series(path, strict=True)
    vtk_errors.clear()


def test_times_are_sorted_and_those_before_a_restart_left_out(tmp_path):
    write_series(tmp_path)
    order = [2, 0, 1]
    series = read_series(write_pvd(tmp_path, [(TIMES[i], f"f{i}.vtu") for i in order]))
    assert_grows(series)
    assert "sorted by time" in series.notes[0]
    rows = [(0.0, "f0.vtu"), (0.1, "f2.vtu"), (0.25, "f0.vtu"), (0.1, "f1.vtu"), (0.25, "f2.vtu")]
    series = read_series(write_pvd(tmp_path, rows))
    assert_grows(series)
    assert "as after a restart: 2 files that it replaced were left out" in series.notes[0]


def test_a_changed_mesh_has_numbers_of_the_whole_body(tmp_path):
    path = write_series(tmp_path)
    fewer = pyvista.UnstructuredGrid({10: CELLS[:-1]}, move_points(0.1))
    fewer.save(tmp_path / "f1.vtu")
    series = read_series(path)
    before, changed, after = series
    assert "topology changes" in changed.fault and not before.fault and not after.fault
    assert np.isnan(measure(changed)["volume_ratio"]).all() and changed.v is None
    assert measure(changed)["total_volume"] == pytest.approx(fewer.volume)
    assert measure(changed)["volume_drift"] == pytest.approx(fewer.volume / series.mesh.rest_volumes.sum() - 1)
    center = np.average(fewer.cell_centers().points, axis=0, weights=np.abs(fewer.compute_cell_sizes()["Volume"]))
    assert measure(changed)["center_of_mass"] == pytest.approx(center)


def test_flat_cells_at_rest_are_an_error(tmp_path):
    path = write_series(tmp_path)
    flat = POINTS.copy()
    flat[:, 2] = 0
    make_grid(0, points=flat).save(tmp_path / "f0.vtu")
    with pytest.raises(SeriesError, match=r"rest state: .* flat"):
        read_series(path)


def test_a_surface_is_measured_by_areas(tmp_path):
    sphere = pyvista.Sphere(theta_resolution=8, phi_resolution=8).cast_to_unstructured_grid()
    for i in range(2):
        sphere.points = sphere.points * (1 + 0.1 * i)
        sphere.save(tmp_path / f"f{i}.vtu")
    series = read_series(tmp_path)
    assert any("surface in space" in note for note in series.notes)
    assert measure(series.read_frame(1))["volume_ratio"] == pytest.approx(1.21, rel=1e-5)


@pytest.mark.parametrize("text", ["", "[]", '{"files": [{"name": "a.vtu"}]}'])
def test_a_file_that_is_not_an_index_is_an_error(tmp_path, text):
    (tmp_path / "a.vtu.series").write_text(text)
    with pytest.raises(SeriesError, match="not a ParaView index"):
        read_series(tmp_path / "a.vtu.series")


def test_several_series_in_one_folder_need_a_pattern(tmp_path):
    for name in ("a_0", "a_1", "b_0"):
        make_grid(0).save(tmp_path / f"{name}.vtu")
    with pytest.raises(SeriesError, match=r"a_\*.vtu \(2\), b_\*.vtu \(1\)"):
        read_series(tmp_path)
    assert len(read_series(tmp_path / "a_*.vtu")) == 2
    (tmp_path / "empty").mkdir()
    with pytest.raises(SeriesError, match="no series there"):
        read_series(tmp_path / "empty")


def test_a_series_describes_itself_in_one_line(tmp_path):
    path = write_series(tmp_path)
    (tmp_path / "f1.vtu").unlink()
    series = read_series(path, name="<their>")
    assert isinstance(series.mesh, Mesh)
    assert repr(series) == f"<Series <their>: 2 frames, t = 0 to 0.25 s, {len(CELLS)} cells in 3D>"
    html = series._repr_html_()
    assert html.startswith("<b>&lt;their&gt;</b>: 2 frames") and "f1.vtu" in html and len(html) < 500


def test_a_part_of_a_series_keeps_the_layout(tmp_path):
    series = read_series(write_series(tmp_path))
    part = series.select_frames([1, 2])
    assert part.mesh is series.mesh and part.times == tuple(TIMES[1:])
    assert np.array_equal(part.read_frame(0).x, move_points(TIMES[1]))


def test_paths_are_text_or_path_like(tmp_path):
    class Place:
        def __fspath__(self):
            return str(path)

    path = write_series(tmp_path)
    assert len(read_series(Place())) == len(read_series(str(path))) == len(read_series(path)) == 3
    assert open_lazily(Place()).sizes["time"] == 3


# xarray


def open_lazily(path, **options):
    return xarray.open_dataset(path, engine=engine.SeriesBackend, **options)


def write_fields(folder):
    """Frames with fields of many kinds."""
    for i, t in enumerate(TIMES):
        grid = make_grid(t)
        grid.point_data["velocity"] = GROWTH * POINTS
        grid.point_data["temperature"] = np.float32(t) + np.arange(len(POINTS), dtype=np.float32)
        grid.cell_data["part"] = np.arange(len(CELLS), dtype=np.int32)
        grid.cell_data["stress"] = np.full((len(CELLS), 6), t)
        grid.field_data["kinetic_energy"] = [t]
        grid.save(folder / f"f{i}.vtu")
    return write_pvd(folder, [(t, f"f{i}.vtu") for i, t in enumerate(TIMES)])


def test_a_dataset_reads_frames_when_values_are_needed(tmp_path, monkeypatch):
    path = write_fields(tmp_path)
    read = []

    def count(file, *args, **options):
        read.append(file.name)
        return read_grid(file, *args, **options)

    monkeypatch.setattr("pipeline.series.series.read_grid", count)
    monkeypatch.setattr(engine, "_CACHE_BYTES", 0)  # a series that is too long to look at all of its frames
    dataset = open_lazily(path)
    assert set(read) == {"f0.vtu", "f1.vtu", "f2.vtu"} and read.count("f0.vtu") == 1
    read.clear()
    assert dict(dataset.sizes) == {
        "time": 3, "node": len(POINTS), "cell": len(CELLS), "axis": 3, "corner": 4, "stress_component": 6
    }  # fmt: skip
    assert dataset["time"].values.tolist() == TIMES and dataset["time"].attrs["units"] == "s"
    assert dataset["kinetic_energy"].attrs["units"] == "J" and dataset["velocity"].attrs["units"] == "m s-1"
    assert dataset["part"].dtype == np.int32 and dataset["temperature"].dtype == np.float32
    assert read == []
    assert (dataset["velocity"][0].values == GROWTH * POINTS).all() and (dataset["stress"][0] == 0).all()
    assert read == ["f0.vtu"]
    one = dataset.isel(time=1)
    assert one["displacement"].values == pytest.approx(move_points(0.1) - POINTS)
    assert one["velocity"].values == pytest.approx(GROWTH * POINTS)
    assert set(read) == {"f0.vtu", "f1.vtu"}
    assert dataset["temperature"][:, 3].values == pytest.approx([3, 3.1, 3.25])
    assert dataset["stress"][::2, [1, 0], 2].values.tolist() == [[0, 0], [0.25, 0.25]]
    assert dataset["temperature"].isel(time=[2, 0], node=slice(2)).values == pytest.approx(
        np.array([[0.25, 1.25], [0, 1]])
    )
    assert dataset["displacement"].isel(time=slice(0, 0)).shape == (0, len(POINTS), 3)
    assert dataset["kinetic_energy"].values.tolist() == TIMES
    assert_conventional(dataset.drop_vars(["temperature", "stress", "part"]))


def test_a_dataset_can_be_pickled(tmp_path):
    dataset = open_lazily(write_fields(tmp_path))
    xarray.testing.assert_identical(pickle.loads(pickle.dumps(dataset)), dataset)


def test_dask_gets_one_chunk_per_frame(tmp_path):
    pytest.importorskip("dask")
    dataset = open_lazily(write_fields(tmp_path), chunks={})
    assert dataset["displacement"].chunks == ((1, 1, 1), (len(POINTS),), (3,))
    assert dataset["displacement"].mean("time").values == pytest.approx(
        np.mean([move_points(t) for t in TIMES], 0) - POINTS
    )


def test_read_xdmf_with_hdf5(tmp_path, monkeypatch):
    pytest.importorskip("h5py")
    monkeypatch.chdir(tmp_path)  # meshio writes the other file here
    assert_grows(read_series(write_xdmf(tmp_path / "a.xdmf", "HDF")))


def test_the_accessor_measures_as_the_package_does(tmp_path):
    dataset = open_lazily(write_fields(tmp_path))
    ratio = dataset.deformation.volume_ratio()
    assert ratio.dims == ("time", "cell") and ratio.attrs["units"] == "1"
    for i, frame in enumerate(read_series(tmp_path / "their.pvd")):
        measured = measure(frame)
        assert ratio[i].values == pytest.approx(measured["volume_ratio"], rel=1e-13)
        assert dataset.deformation.rotation_angle()[i].values == pytest.approx(measured["rotation_angle"], abs=1e-5)
    worst = dataset.deformation.worst()
    assert worst.volume_ratio == pytest.approx((1 + GROWTH * TIMES[-1]) ** 3) and worst.time == TIMES[-1]
    grid = dataset.deformation.to_pyvista(0.11)
    assert np.asarray(grid.points) == pytest.approx(move_points(0.1))
    assert grid.cell_data["part"].dtype == np.int32
    with pytest.raises(SeriesError, match="no connectivity"):
        dataset.drop_vars("connectivity").deformation.worst()


def test_a_dataset_survives_writing_and_reading(tmp_path):
    dataset = open_lazily(write_fields(tmp_path))
    dataset["temperature"].attrs["units"] = "K"
    dataset["volume_ratio"] = dataset.deformation.volume_ratio()
    dataset.attrs["history"] = "measured"
    path = write_pvd_series(dataset, tmp_path / "again.pvd")
    again = open_lazily(path)
    xarray.testing.assert_identical(again, dataset)
    assert {name: one.dtype for name, one in again.items()} == {name: one.dtype for name, one in dataset.items()}
    twice = open_lazily(write_pvd_series(again, tmp_path / "twice.pvd"))
    xarray.testing.assert_identical(twice, dataset)
    assert b"<AppendedData" not in (tmp_path / "again" / "frame_000000.vtu").read_bytes()
    with pytest.raises(SeriesError, match="frames cannot hold mean"):
        write_pvd_series(dataset.assign(mean=dataset["velocity"].mean("time")), tmp_path / "no.pvd")


def test_a_planar_dataset_survives_writing_and_reading(tmp_path):
    points, cells = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]])
    for i, t in enumerate(TIMES):
        meshio.write(tmp_path / f"f{i}.vtu", meshio.Mesh(points * [1 + t, 1, 1], [("triangle", cells)]))
    dataset = open_lazily(str(tmp_path / "f0.vtu").replace("f0", "f*"))
    assert dataset.deformation.volume_ratio().values[1] == pytest.approx([1.1, 1.1])
    xarray.testing.assert_identical(open_lazily(write_pvd_series(dataset, tmp_path / "a" / "p.pvd")), dataset)


def test_xarray_finds_the_engine(tmp_path, installed):
    path = write_fields(tmp_path)
    code = f"import xarray; ds = xarray.open_dataset({str(path)!r}); print(ds.deformation.worst().time)"
    run = subprocess.run([sys.executable, "-c", code], env=installed, capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["0.25"]


def test_the_code_in_the_docs_runs(tmp_path, installed, project_root):
    """Run every python block of docs/analysis.md in order, on a series of three frames."""
    page = project_root / "docs" / "analysis.md"
    shutil.copy(write_fields(tmp_path), tmp_path / "series.pvd")
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.S)
    assert len(blocks) >= 4
    run = subprocess.run(
        [sys.executable, "-c", "\n".join(blocks)], env=installed, capture_output=True, text=True, cwd=tmp_path
    )
    assert run.returncode == 0, run.stderr
