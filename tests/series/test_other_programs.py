"""Unchanged results of other solvers, and long series: the same numbers, the memory of a few frames."""

import resource
import tracemalloc
from pathlib import Path

import meshio
import numpy as np
import pytest
import xarray

from pipeline.cli import main
from pipeline.errors import SeriesError
from pipeline.mesh.shapes import box
from pipeline.results.analysis_folder import analyze
from pipeline.run.measures import measure
from pipeline.series import read_series
from pipeline.series import xarray_plugin as engine
from pipeline.series.frame_files import read_grid
from tests.bodies import skip_figures
from tests.series.test_series import CELLS, POINTS, TIMES, make_grid, move_points, write_pvd, write_series


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


def test_one_flat_cell_at_rest_is_named(tmp_path, capfd):
    flat = POINTS.copy()
    corners = CELLS[5]
    flat[corners[3]] = flat[corners[:3]].mean(axis=0)
    for i, t in enumerate(TIMES):
        make_grid(0, points=flat * (1 + t)).save(tmp_path / f"f{i}.vtu")
    path = write_pvd(tmp_path, [(t, f"f{i}.vtu") for i, t in enumerate(TIMES)])
    with pytest.raises(SeriesError, match=r"rest state: .*inverted or flat tetrahedron cells, first \d+ with volume"):
        read_series(path)
    assert main(["analyze", str(path), "--out", str(tmp_path / "out")]) == 2
    assert capfd.readouterr().err.count("\n") == 1 and not (tmp_path / "out").exists()


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
