"""Datasets of any series: fields of all frames, names that can be stored, and every way out and back."""

import pickle
import shutil
import subprocess
import sys

import cf_xarray.units
import numpy as np
import pint_xarray  # noqa: F401  (registers ds.pint)
import pytest
import pyvista
import xarray

from pipeline.errors import SeriesError
from pipeline.series import read_series
from pipeline.series import xarray_plugin as engine
from pipeline.series.dataset.attributes import ATTRIBUTES
from tests.foreign.writers import bar, index, stretch, write_vtu

POINTS, CELLS = bar()
N, E = len(POINTS), len(CELLS)
TETRAHEDRA = [(10, CELLS)]


def write(folder, *frames, points=None):
    """A series of the stretched bar, with these fields (of points, of cells, of the body) in each frame."""
    for k, fields in enumerate(frames):
        x = stretch(POINTS, 1 + 0.1 * k) if points is None else points[k]
        write_vtu(folder / f"f_{k}.vtu", x, TETRAHEDRA, *fields)
    index(folder, frames=range(len(frames)))
    return folder / "s.pvd"


def open_lazily(path, **options):
    return xarray.open_dataset(path, engine=engine.SeriesBackend, **options)


def cellular(**fields):
    return ({}, {name: np.full(E, value) for name, value in fields.items()})


# Fields of all frames


def test_a_field_that_comes_late_or_vanishes_is_nan_elsewhere(tmp_path):
    frames = [
        cellular(a=np.int64(1)),
        cellular(b=2.5),
        cellular(a=np.int64(3), c=np.float32(4)),
        cellular(a=np.int64(5)),
    ]
    dataset = open_lazily(write(tmp_path, *frames))
    assert dataset["a"].dtype == dataset["b"].dtype == np.float64 and dataset["c"].dtype == np.float32
    assert dataset["a"][:, 0].values == pytest.approx([1, np.nan, 3, 5], nan_ok=True)
    assert dataset["b"][:, 3].values == pytest.approx([np.nan, 2.5, np.nan, np.nan], nan_ok=True)
    assert dataset["c"].isel(cell=[2], time=[2, 1]).values.ravel() == pytest.approx([4, np.nan], nan_ok=True)
    assert "not in all frames, NaN in the others: a, b, c" in dataset.attrs["comment"]


def test_integers_stay_integers_and_types_widen_over_all_frames(tmp_path):
    kinds = [(np.uint8, np.float32, np.int64), (np.int32, np.float64, np.uint8), (np.int32, np.float32, np.float64)]
    values = [(7, 0.5, 2**40), (-300, 1e9 + 1, 3), (2**30, 0.25, 0.5)]
    frames = [
        cellular(**{n: t(v) for n, t, v in zip("abc", *pair, strict=True)}) for pair in zip(kinds, values, strict=True)
    ]
    dataset = open_lazily(write(tmp_path, *frames))
    assert [dataset[name].dtype for name in "abc"] == [np.int32, np.float64, np.float64]
    for k, expected in enumerate(values):
        assert [dataset[name][k, 0].item() for name in "abc"] == list(expected)


def test_a_shape_that_changes_and_texts_are_left_out_with_a_note(tmp_path):
    vector, tensor = np.zeros((E, 3)), np.zeros((E, 6))
    path = write(tmp_path, ({}, {"v": vector, "w": vector}), ({}, {"v": tensor, "w": vector}))
    dataset = open_lazily(path)
    assert "v" not in dataset and dataset["w"].dims == ("time", "cell", "axis")
    assert (
        "cell field v is left out: its shape changes, from (3,) in f_0.vtu to (6,) in f_1.vtu"
        in dataset.attrs["comment"]
    )


def long_series(folder, late):
    """Eleven frames, of which the sixth, not looked at if there are too many, has other fields."""
    frames = [cellular(a=np.int32(k), b=np.float32(k)) for k in range(11)]
    frames[6] = late
    return write(folder, *frames)


@pytest.mark.parametrize(
    ("late", "message"),
    [
        (cellular(b=np.float32(6)), "f_6.vtu: the cell field a is missing, and integers have no NaN: scan_all = True"),
        (
            cellular(a=0.5, b=np.float32(6)),
            "f_6.vtu: the cell field a is float64, and int32 cannot hold all its numbers",
        ),
        (cellular(a=np.int64(2**40), b=np.float32(0)), "f_6.vtu: the cell field a is int64, and int32 cannot hold"),
        (({}, {"a": np.zeros((E, 3))}), "f_6.vtu: the cell field a has shape (12, 3), in the frames looked at (12,)"),
    ],
)
def test_a_frame_that_contradicts_the_table_is_an_error(tmp_path, monkeypatch, late, message):
    monkeypatch.setattr(engine, "_CACHE_BYTES", 0)
    path = long_series(tmp_path, late)
    dataset = open_lazily(path)
    assert "frames 0, 1, 5, 10 of 11; scan_all = True looks at all" in dataset.attrs["comment"]
    assert dataset["a"].dtype == np.int32 and dataset["a"][:6, 0].values.tolist() == list(range(6))
    with pytest.raises(SeriesError) as caught:
        dataset["a"].load()
    assert message in str(caught.value)
    whole = open_lazily(path, scan_all=True)
    if "shape" in message:
        assert "a" not in whole and "its shape changes" in whole.attrs["comment"]
    else:
        assert whole["a"][6, 0].values == pytest.approx(late[1].get("a", [np.nan])[0], nan_ok=True)


def test_a_frame_that_was_not_looked_at_may_have_other_types_if_no_number_changes(tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "_CACHE_BYTES", 0)
    dataset = open_lazily(long_series(tmp_path, cellular(a=6.0)))
    assert dataset["a"].dtype == np.int32 and dataset["a"][:, 0].values.tolist() == list(range(11))
    assert np.isnan(dataset["b"][6]).all() and dataset["b"][7, 0] == 7


# Names


def test_names_of_points_cells_and_the_body_are_told_apart(tmp_path):
    fields = ({"T": np.full(N, 1.0)}, {"T": np.full(E, 2.0), "T_cell": np.full(E, 3.0)}, {"T": [4.0]})
    dataset = open_lazily(write(tmp_path, fields, fields))
    found = {
        name: (dataset[name].dims[1:], dataset[name].values.ravel()[0]) for name in dataset if name.startswith("T")
    }
    assert found == {
        "T": (("node",), 1.0), "T_cell": (("cell",), 2.0), "T_cell_cell": (("cell",), 3.0), "T_field": ((), 4.0)
    }  # fmt: skip
    assert dataset["T_cell"].attrs["comment"] == "the cell field T of the files"
    assert "the cell field T is named T_cell: that name is taken" in dataset.attrs["comment"]


ODD = ["a/b", "/", "..", "__hidden", "[MPa] x", " spaces ", "tab\there", "σ", "-1", "x" * 300, "mesh", "node_x"]


def test_every_name_can_be_stored_by_netcdf_and_zarr(tmp_path):
    fields = ({name: np.full(N, 1.0 * k) for k, name in enumerate(ODD)},)
    dataset = open_lazily(write(tmp_path, fields, fields)).load()
    assert "a_b" in dataset and "σ" in dataset and "mesh_point" in dataset and "node_x_point" in dataset
    dataset.to_netcdf(tmp_path / "a.nc", engine="netcdf4")
    with xarray.open_dataset(tmp_path / "a.nc", engine="netcdf4") as again:
        xarray.testing.assert_identical(again.load(), dataset)
    dataset.to_zarr(tmp_path / "a.zarr")
    xarray.testing.assert_equal(xarray.open_zarr(tmp_path / "a.zarr").load(), dataset)
    xarray.testing.assert_identical(open_lazily(dataset.deformation.to_pvd(tmp_path / "again.pvd")), dataset)


def test_a_measure_of_another_program_keeps_its_name_only_if_it_agrees(tmp_path):
    ratios = [1.0, 1.1]
    right = [cellular(volume_ratio=np.float32(ratio)) for ratio in ratios]
    dataset = open_lazily(write(tmp_path, *right))
    assert dataset["volume_ratio"].dtype == np.float32 and dataset["volume_ratio"].attrs["units"] == "1"
    (tmp_path / "b").mkdir()
    dataset = open_lazily(write(tmp_path / "b", *right[::-1]))
    assert "volume_ratio" not in dataset and dataset["volume_ratio_cell"][0, 0] == np.float32(1.1)
    assert "units" not in dataset["volume_ratio_cell"].attrs


def test_a_displacement_that_is_not_that_of_the_points_is_kept_beside_it(tmp_path):
    u = [stretch(POINTS, 1 + 0.1 * k) - POINTS for k in range(3)]
    dataset = open_lazily(write(tmp_path, *(({"displacement": field},) for field in u)))
    assert "displacement_point" not in dataset
    assert dataset["displacement"].max(["node", "axis"]).values == pytest.approx([0, 0.2, 0.4])
    (tmp_path / "b").mkdir()
    dataset = open_lazily(write(tmp_path / "b", *(({"displacement": 2 * field},) for field in u)), displacement="none")
    assert dataset["displacement"].max(["node", "axis"]).values == pytest.approx([0, 0.2, 0.4])
    assert dataset["displacement_point"].max(["node", "axis"]).values == pytest.approx([0, 0.4, 0.8])


def test_a_small_displacement_agrees_with_the_points_or_is_kept(tmp_path):
    """A strain of one part in a million, which the points of single precision hold only roughly."""
    u = [1e-6 * k * (stretch(POINTS, 2.0) - POINTS) for k in range(3)]
    exact = open_lazily(write(tmp_path, *(({"displacement": field},) for field in u), points=[POINTS + f for f in u]))
    assert "displacement_point" not in exact
    (tmp_path / "b").mkdir()
    rounded = [(POINTS + field).astype(np.float32) for field in u]
    path = write(tmp_path / "b", *(({"displacement": field},) for field in u), points=rounded)
    dataset = open_lazily(path, displacement="none", rest="first")
    found = dataset["displacement_point"] if "displacement_point" in dataset else dataset["displacement"]
    assert found.max(["node", "axis"]).values == pytest.approx([0, 2e-6, 4e-6], rel=1e-3)


def test_decisions_about_the_files_are_attributes(tmp_path):
    u = [stretch(POINTS, 1 + 0.1 * k) - POINTS for k in (1, 2, 3)]
    points = [stretch(POINTS, 1 + 0.1 * k) for k in (1, 2, 3)]
    attributes = open_lazily(write(tmp_path, *(({"u": field},) for field in u), points=points)).attrs
    assert attributes["points"] == "deformed points, which contain u" and "minus u" in attributes["rest_state"]
    assert attributes["cells"] == "12 tetrahedra in 3D" and attributes["times"].endswith("from 0 to 0.2 s")
    (tmp_path / "b").mkdir()
    path = write(tmp_path / "b", *(({"u": field - u[0]},) for field in u), points=[POINTS] * 3)
    with open_lazily(path) as dataset:
        assert dataset["displacement"].attrs["comment"] == "the files have rest points + u"
        assert "comment" in dataset.attrs and "left_out" not in dataset.attrs
        dataset.to_netcdf(tmp_path / "a.nc", engine="netcdf4")
    with xarray.open_dataset(tmp_path / "a.nc", engine="netcdf4") as again:
        assert again.attrs["points"] == "rest points + u"


# Ways out and back


def test_a_dataset_goes_through_netcdf_zarr_and_pickle(tmp_path):
    fields = [({"v": np.full((N, 3), float(k))}, {"id": np.arange(E)}, {"energy": [float(k)]}) for k in range(3)]
    dataset = open_lazily(write(tmp_path, *fields), chunks={})
    assert dataset["v"].chunks == ((1, 1, 1), (N,), (3,))
    ratio = dataset.deformation.volume_ratio()
    assert ratio.chunks == ((1, 1, 1), (E,))
    assert ratio.values == pytest.approx(np.repeat([[1.0], [1.1], [1.2]], E, axis=1))
    dataset.to_netcdf(tmp_path / "a.nc", engine="netcdf4")
    dataset.to_zarr(tmp_path / "a.zarr")
    netcdf, zarr = xarray.open_dataset(tmp_path / "a.nc", engine="netcdf4"), xarray.open_zarr(tmp_path / "a.zarr")
    for again in (netcdf, zarr, pickle.loads(pickle.dumps(dataset))):
        xarray.testing.assert_identical(again.load(), dataset.load())
        assert again["id"].dtype == np.int64
        assert again.deformation.worst() == dataset.deformation.worst()
        xarray.testing.assert_identical(again.deformation.volume_ratio(), dataset.deformation.volume_ratio())
    netcdf.close()


def test_a_temporal_vtkhdf_opens_without_naming_the_engine(tmp_path, installed):
    """xarray asks netCDF4 first, which takes every HDF5 file: the dataset would be empty."""
    pytest.importorskip("h5py")
    from pipeline.case import load_case
    from pipeline.results.case_run import run_case
    from tests.bodies import write_case

    case = load_case(write_case(tmp_path, output={"format": "vtkhdf"}, movie=None))
    folder = run_case(case, tmp_path / "out", variants=["linear"], movie=False).folder / "linear"
    code = (
        f"import xarray; ds = xarray.open_dataset({str(folder / 'series.vtkhdf')!r}); print(ds.sizes['time'], len(ds))"
    )
    run = subprocess.run([sys.executable, "-c", code], env=installed, capture_output=True, text=True, check=True)
    frames, variables = map(int, run.stdout.split())
    assert frames == len(read_series(folder)) and variables > 5
    shutil.copy(folder / "series.vtkhdf", tmp_path / "a.hdf")
    xarray.Dataset({"a": 1}).to_netcdf(tmp_path / "b.hdf", engine="netcdf4")
    paths = [str(tmp_path / name) for name in ("a.hdf", "b.hdf")]
    code = f"import xarray; print(*(len(xarray.open_dataset(path)) for path in {paths!r}))"
    run = subprocess.run([sys.executable, "-c", code], env=installed, capture_output=True, text=True, check=True)
    assert list(map(int, run.stdout.split())) == [variables, 1]
    nc = next(folder.glob("*.nc"))
    code = f"import xarray; print(len(xarray.open_dataset({str(nc)!r})))"
    run = subprocess.run([sys.executable, "-c", code], env=installed, capture_output=True, text=True, check=True)
    assert int(run.stdout) > 5


# The accessor


def moved(folder):
    return open_lazily(write(folder, *(({},) for _ in range(3))))


def test_repeated_times_and_further_dimensions_are_told(tmp_path):
    dataset = moved(tmp_path).load()
    both = xarray.concat([dataset, dataset], "time", data_vars="minimal")
    assert both.deformation.worst() == dataset.deformation.worst()
    with pytest.raises(SeriesError, match=r"2 frames have the time 0\.1 s: drop_duplicates"):
        both.deformation.to_pyvista(0.1)
    with pytest.raises(SeriesError, match="some times occur twice"):
        both.deformation.to_pvd(tmp_path / "both.pvd")
    assert both.drop_duplicates("time").deformation.to_pyvista(0.1).n_cells == E
    variants = xarray.concat([dataset, dataset], "variant", data_vars=["displacement"])
    with pytest.raises(
        SeriesError, match=r"displacement has the dimensions variant, time, .*: select one variant first"
    ):
        variants.deformation.worst()
    assert variants.isel(variant=1).deformation.worst() == dataset.deformation.worst()
    everything = xarray.concat([dataset, dataset], "time", data_vars="all")
    with pytest.raises(SeriesError, match=r"rest_position has the dimensions .*: the mesh must be the same everywhere"):
        everything.deformation.volume_ratio()
    with pytest.raises(SeriesError, match=r"keep time \(isel"):
        dataset.isel(time=1).deformation.volume_ratio()


def test_missing_nodes_are_nan_in_their_cells_only(tmp_path):
    dataset = moved(tmp_path).load()
    dataset["displacement"][2, CELLS[0, 0]] = np.nan
    lost = (CELLS[0, 0] == CELLS).any(axis=1)
    assert 0 < lost.sum() < E
    for name in ("volume_ratio", "rotation_angle", "volume_ratio_min"):
        measured = getattr(dataset.deformation, name)()
        assert (np.isnan(measured[2].values) == lost).all() and np.isfinite(measured[:2]).all()
    assert not dataset.deformation.is_inverted().any()
    assert dataset.deformation.worst().volume_ratio == pytest.approx(1.2)
    assert dataset.deformation.to_pyvista(0.2).n_cells == E - lost.sum()
    dataset["displacement"][:] = np.nan
    assert dataset.deformation.worst().volume_ratio == 1.0


def test_missing_nodes_survive_in_frames(tmp_path):
    dataset = moved(tmp_path).load()
    dataset["displacement"][2, CELLS[0, 0]] = np.nan
    again = open_lazily(dataset.deformation.to_pvd(tmp_path / "again.pvd"))
    xarray.testing.assert_identical(again.load(), dataset)


def test_units_that_differ_are_an_error(tmp_path):
    dataset = moved(tmp_path)
    in_mm = dataset.assign(displacement=1000 * dataset["displacement"].load())
    in_mm["displacement"].attrs["units"] = "mm"
    with pytest.raises(SeriesError, match="rest_position is in m, displacement in mm: convert one of them"):
        in_mm.deformation.volume_ratio()
    quantities = dataset.load().pint.quantify(unit_registry=cf_xarray.units.units)
    with pytest.raises(SeriesError, match=r"holds quantities: use ds\.pint\.dequantify"):
        quantities.deformation.worst()
    assert quantities.pint.dequantify("cf").deformation.worst() == dataset.deformation.worst()


def test_exported_frames_are_not_guessed_about_unless_another_program_changed_them(tmp_path):
    """A file's own displacement stays one; points that were warped once more are believed, not the old displacement."""
    fields = [({"displacement": np.ones((N, 2))},)] * 2
    dataset = open_lazily(write(tmp_path, *fields, points=[POINTS] * 2), displacement="none")
    again = open_lazily(dataset.deformation.to_pvd(tmp_path / "a.pvd"))
    xarray.testing.assert_identical(again.load(), dataset.load())
    moving = moved(tmp_path).deformation.to_pvd(tmp_path / "b.pvd")
    for k in range(3):
        grid = pyvista.read(tmp_path / "b" / f"frame_{k:06d}.vtu")
        grid.points += grid.point_data["displacement"]
        grid.save(tmp_path / "b" / f"frame_{k:06d}.vtu")
    dataset = open_lazily(moving)
    assert dataset["displacement"].max(["node", "axis"]).values == pytest.approx([0, 0.4, 0.8])
    assert dataset["displacement_point"].max(["node", "axis"]).values == pytest.approx([0, 0.2, 0.4])
    assert dataset.deformation.worst().volume_ratio == pytest.approx(1.4)


def test_an_inverted_cell_is_told(tmp_path):
    dataset = moved(tmp_path).load()
    dataset["displacement"][1, :, 0] = -2 * dataset["rest_position"][:, 0]
    inverted = dataset.deformation.is_inverted()
    assert inverted.dtype == bool and inverted.any("cell").values.tolist() == [False, True, False]
    assert dataset.deformation.volume_ratio_max()[1].values == pytest.approx(-1.0)


def test_attributes_survive_in_frames(tmp_path):
    dataset = moved(tmp_path)
    dataset.attrs["history"] = "made by hand"
    path = dataset.deformation.to_pvd(tmp_path / "again.pvd")
    assert ATTRIBUTES in read_series(path).read_grid(0).field_data
    assert open_lazily(path).attrs == dataset.attrs


def test_frames_with_other_cells_are_nan(tmp_path):
    """A remeshed frame: no values of points and cells, integers become floating, numbers of the body stay."""
    path = write(tmp_path, *(({"n": np.arange(N)}, {"id": np.arange(E)}, {"work": [k]}) for k in range(3)))
    other, cells = bar((3, 1, 1), (2.0, 1.0, 1.0))
    write_vtu(tmp_path / "f_2.vtu", other, [(10, cells)], {"n": np.arange(len(other))}, {}, {"work": [2]})
    dataset = open_lazily(path)
    assert dataset["n"].dtype == np.float64 and dataset["work"].values.tolist() == [0, 1, 2]
    for name in ("n", "id", "displacement"):
        assert np.isnan(dataset[name][2]).all() and np.isfinite(dataset[name][:2]).all()
    assert "1 frames have other cells, first 2" in dataset.attrs["comment"]
    assert dataset.deformation.worst().volume_ratio == pytest.approx(1.1)


FIELDS = [
    "a",
    "T",
    "time",
    "node",
    "mesh",
    "v/w",
    "volume_ratio",
    "displacement",
    "axis",
    "cell_type",
    "T_cell",
    "node_x",
]
TYPES = {np.uint8: 200, np.int32: 2**30, np.int64: 2**52, np.float32: 0, np.float64: 0}


def draw(rng, count):
    """Values of a random type, of one, three or six components."""
    kind = list(TYPES)[rng.integers(5)]
    shape = (count, *[(), (), (), (3,), (6,)][rng.integers(5)])
    return (rng.integers(0, TYPES[kind], shape) if TYPES[kind] else rng.normal(size=shape)).astype(kind)


def draw_frames(rng):
    """One to six frames with up to five fields of points and of cells each, that come, go and change their types."""
    bases = [{name: draw(rng, n) for name in rng.permutation(FIELDS)[: rng.integers(0, 6)]} for n in (N, E)]
    return [
        [
            {
                name: draw(rng, len(old)) if rng.random() < 0.15 else old
                for name, old in base.items()
                if rng.random() > 0.15
            }
            for base in bases
        ]
        for _ in range(rng.integers(1, 7))
    ]


@pytest.mark.parametrize("seed", range(40))
def test_a_random_table_is_that_of_the_files(tmp_path, monkeypatch, seed):
    """Each value is that of its file, NaN if it has none, or reading it is an error that names a file."""
    frames = draw_frames(np.random.default_rng(seed))
    monkeypatch.setattr(engine, "_CACHE_BYTES", 0 if seed % 2 else 1 << 25)  # look at some frames, or at all
    dataset = open_lazily(write(tmp_path, *frames), displacement="none", rest="first")
    seen = set()
    for name, variable in dataset.data_vars.items():
        if "time" not in variable.dims or name == "displacement":
            continue
        place = ("node", "cell").index(variable.dims[1])
        source = variable.attrs.get("comment", f" field {name}").split(" field ", 1)[1].removesuffix(" of the files")
        seen.add((place, source))
        try:
            values = variable.values
        except SeriesError as error:
            assert "f_" in str(error)
            continue
        for k, frame in enumerate(frames):
            expected = frame[place].get(source, np.nan)
            assert np.array_equal(values[k], np.broadcast_to(expected, values[k].shape), equal_nan=True)
    if seed % 2:
        return
    for place, source in {(k, name) for frame in frames for k in (0, 1) for name in frame[k]}:
        shapes = {frame[place][source].shape for frame in frames if source in frame[place]}
        assert (place, source) in seen or len(shapes) > 1
