"""Results of other programs, unchanged: the program's own numbers. Long series: the memory of a few frames.

Every entry of an expected.json in tests/programs is one series that a program wrote, with values from that program's
own arrays. Cells are matched by the means of their corners at rest.
"""

import json
import re
import resource
import tracemalloc
from pathlib import Path

import meshio
import numpy as np
import pytest
import xarray
from scipy.spatial import cKDTree

from pipeline.cli import main
from pipeline.errors import SeriesError
from pipeline.mesh.shapes import box
from pipeline.results.analysis_folder import analyze
from pipeline.run.measures import measure
from pipeline.series import Series, read_series
from pipeline.series import xarray_plugin as engine
from pipeline.series.files.frame_files import read_grid
from tests.bodies import skip_figures
from tests.series.test_series import CELLS, POINTS, TIMES, make_grid, move_points, write_pvd, write_series

PROGRAMS = Path(__file__).parents[1] / "programs"
# Corners of cells by their number in VTK: triangles, quadrilaterals, tetrahedra, pyramids, wedges, hexahedra.
KINDS = {
    3: (5, 22, 34, 69),
    4: (9, 23, 28, 70, 10, 24, 71),
    5: (14, 27, 37, 74),
    6: (13, 26, 32, 73),
    8: (12, 25, 29, 72),
}
CORNERS = {kind: n for n, kinds in KINDS.items() for kind in kinds}


def list_entries():
    for path in sorted(PROGRAMS.rglob("expected.json")):
        for entry in json.loads(path.read_text()):
            name = f"{path.parent.relative_to(PROGRAMS).as_posix()}/{entry['series']}"
            yield pytest.param(path.parent, entry, id=name)


def find_centers(series: Series) -> np.ndarray:
    """Return the means (cell, d) of the corners of the cells at rest, in space."""
    cells, X = series.mesh.cell_array, series.mesh.points
    firsts = cells.offsets[:-1]
    corners = [CORNERS.get(kind, n) for kind, n in zip(cells.types.tolist(), np.diff(cells.offsets), strict=True)]
    return np.array([X[cells.connectivity[i : i + n]].mean(axis=0) for i, n in zip(firsts, corners, strict=True)])


@pytest.mark.parametrize(("folder", "entry"), list(list_entries()))
def test_the_numbers_are_those_of_the_program(folder, entry):
    if "refused" in entry:
        with pytest.raises(SeriesError, match=entry["refused"]):
            read_series(folder / entry["series"], **entry.get("options", {}))
        return
    if "noted" in entry:
        notes = read_series(folder / entry["series"]).notes
        assert any(re.search(entry["noted"], note) for note in notes), notes
        return
    series = read_series(folder / entry["series"], **entry.get("options", {}))
    tolerance = entry.get("accuracy", 1e-8)
    assert series.times == pytest.approx(entry["times"], rel=1e-6, abs=1e-12)
    centers, found = np.array(entry["centers"]), find_centers(series)
    assert len(found) == len(centers)
    distances, order = cKDTree(centers).query(found)
    assert distances.max() < 10 * tolerance and len(set(order)) == len(centers)
    assert series.mesh.rest_volumes == pytest.approx(np.array(entry["rest_volume"])[order], rel=10 * tolerance)
    for k, frame in enumerate(series):
        values = measure(frame)
        assert values["total_volume"] == pytest.approx(entry["total_volume"][k], rel=tolerance)
        assert values["volume_ratio"] == pytest.approx(np.array(entry["volume_ratio"][k])[order], rel=10 * tolerance)
        if entry["rotation_angle"] is None:  # the program has none
            continue
        angles = np.array(entry["rotation_angle"][k])[order]
        # An angle near 0 is the root of a difference of rounding errors.
        assert values["rotation_angle"] == pytest.approx(angles, abs=max(1e-5, 1e3 * tolerance))
    worst = np.abs(np.array(entry["volume_ratio"]) - 1).max()
    assert worst > 0.01, "a series that stays at rest tests nothing"


@pytest.mark.slow
@pytest.mark.parametrize(("folder", "entry"), [entry for entry in list_entries() if "total_volume" in entry.values[1]])
def test_analyze_finds_the_worst_cell_of_the_program(folder, entry, tmp_path):
    analysis = analyze(folder / entry["series"], tmp_path, **entry.get("options", {}))
    ratios = np.array(entry["volume_ratio"])
    frame, _ = np.unravel_index(np.abs(ratios - 1).argmax(), ratios.shape)
    tolerance = 10 * entry.get("accuracy", 1e-8)
    assert abs(analysis.worst_volume_ratio - 1) == pytest.approx(np.abs(ratios - 1).max(), abs=tolerance)
    assert analysis.worst_time == pytest.approx(entry["times"][frame], rel=1e-6)
    with xarray.open_dataset(tmp_path / "statistics.nc", engine="netcdf4") as data:
        assert data["total_volume"].values == pytest.approx(np.array(entry["total_volume"]), rel=tolerance)


def write_felupe_result(folder: Path) -> Path:
    """Return a file of felupe: a cube of neo-Hookean tetrahedra, pulled by 30 % in five steps."""
    import felupe

    region = felupe.RegionTetra(felupe.Cube(n=3).triangulate())
    field = felupe.FieldContainer([felupe.Field(region, dim=3)])
    boundaries = felupe.dof.uniaxial(field, clamped=True, return_loadcase=False)
    solid = felupe.SolidBody(felupe.NeoHooke(mu=1, bulk=2), field)
    ramp = {boundaries["move"]: felupe.math.linsteps([0, 0.3], num=4)}
    job = felupe.Job(steps=[felupe.Step(items=[solid], ramp=ramp, boundaries=boundaries)])
    job.evaluate(filename="result.xdmf", verbose=False)
    return folder / "result.xdmf"


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_volume_ratios_are_the_determinants_of_felupes_deformation_gradients(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # meshio writes the .h5 here
    series = read_series(write_felupe_result(tmp_path))
    assert len(series) == 5 and any("Displacement is taken" in note for note in series.notes)
    for i, frame in enumerate(series):
        F = read_grid(series.files[i], i).cell_data["Deformation Gradient"].reshape(-1, 3, 3)
        assert measure(frame)["volume_ratio"] == pytest.approx(np.linalg.det(F), rel=1e-12)
    assert np.ptp(measure(frame)["volume_ratio"]) > 0.1
    dataset = xarray.open_dataset(tmp_path / "result.xdmf", engine=engine.SeriesBackend)
    assert dataset.deformation.worst().time == dataset["time"].values[-1]


def test_cell_fields_that_are_not_finite_pass_through(tmp_path):
    for i, t in enumerate(TIMES):
        grid = make_grid(t)
        grid.cell_data["stress"] = np.where(np.arange(len(CELLS)) == 7, np.nan, t)
        grid.cell_data["damage"] = np.full(len(CELLS), np.inf)
        grid.save(tmp_path / f"f{i}.vtu")
    path = write_pvd(tmp_path, [(t, f"f{i}.vtu") for i, t in enumerate(TIMES)])
    assert np.isfinite(measure(read_series(path).read_frame(2))["volume_ratio"]).all()
    dataset = xarray.open_dataset(path, engine=engine.SeriesBackend)
    assert np.flatnonzero(np.isnan(dataset["stress"].values[1])).tolist() == [7]
    assert np.isinf(dataset["damage"].values).all()


def test_one_flat_cell_at_rest_is_left_out(tmp_path):
    flat = POINTS.copy()
    corners = CELLS[5]
    flat[corners[3]] = flat[corners[:3]].mean(axis=0)
    for i, t in enumerate(TIMES):
        make_grid(0, points=flat * (1 + t)).save(tmp_path / f"f{i}.vtu")
    series = read_series(write_pvd(tmp_path, [(t, f"f{i}.vtu") for i, t in enumerate(TIMES)]))
    assert len(series.mesh.rest_volumes) == len(CELLS) - 2  # the cell beside it is flat too
    assert any("cells are flat at rest " in note for note in series.notes)
    assert measure(series.read_frame(2))["volume_ratio"] == pytest.approx((1 + TIMES[2]) ** 3)


def test_a_frame_that_cannot_be_read_leaves_no_file(tmp_path, capfd):
    path = write_series(tmp_path)
    text = (tmp_path / "f1.vtu").read_text()
    (tmp_path / "f1.vtu").write_text(text.replace('Name="connectivity"', 'Name="nothing"'))
    assert main(["analyze", str(path), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    assert capfd.readouterr().err.count("\n") == 1
    assert [file for file in (tmp_path / "out").rglob("*") if file.is_file()] == []


# Long series

FRAMES = 60  # 2 000 by hand: docs/reliability.md
GRID = (18, 52, 18)  # 101 088 tetrahedra


def measure_memory() -> int:
    """Return the resident memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


@pytest.mark.slow
def test_many_large_frames_need_the_memory_of_a_few(tmp_path, monkeypatch):
    """Read the same three files over and over; memory kept per frame would add up."""
    skip_figures(monkeypatch)
    mesh = box((4.0, 12.0, 4.0), GRID)
    for i in range(3):
        points = mesh.points * (1 + 0.01 * i)
        meshio.write(tmp_path / f"f{i}.vtu", meshio.Mesh(points, [("tetra", mesh.cells)]), compression=None)
    path = write_pvd(tmp_path, [(float(k), f"f{k % 3}.vtu") for k in range(FRAMES)])
    series = read_series(path)
    memory = []
    analysis = analyze(series, tmp_path / "out", on_frame=lambda *_: memory.append(measure_memory()))
    assert analysis.frames == FRAMES and analysis.worst_volume_ratio == pytest.approx(1.02**3)
    frame_bytes = mesh.points.nbytes + mesh.cells.nbytes
    # a kept frame would leave its points and cells; the heap settles in the first 20
    assert max(memory[20:]) - memory[19] < 0.2 * (FRAMES - 20) * frame_bytes


def test_a_series_without_frames_in_memory_is_small(tmp_path):
    write_series(tmp_path)
    path = write_pvd(tmp_path, [(float(k), f"f{k % 3}.vtu") for k in range(20_000)])
    tracemalloc.start()
    try:
        series = read_series(path)
        size = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert len(series) == 20_000 and series.times[-1] == 19_999.0
    assert np.array_equal(series.read_frame(4).x, move_points(TIMES[1]))
    assert size < 20_000 * 1000  # bytes per frame: a time and a path
