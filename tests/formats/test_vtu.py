"""Inline .vtu read without VTK: the same numbers as VTK's, other encodings left to VTK, damage reported."""

import random
import tracemalloc

import numpy as np
import pytest
import pyvista
import vtk
import xarray
from xarray.backends.locks import SerializableLock

from pipeline.errors import SeriesError
from pipeline.formats import readers, vtu_read
from pipeline.formats.vtu_read import read_inline
from pipeline.series import read_series
from pipeline.series import xarray_plugin as engine
from pipeline.series.dataset.writer import write_pvd_series
from pipeline.series.files.frame_files import read_grid
from tests.series.test_series import (
    CELLS,
    POINTS,
    TIMES,
    make_grid,
    move_points,
    open_lazily,
    write_fields,
    write_pvd,
    write_series,
)


def make_rich_grid(t: float = 0.1) -> pyvista.UnstructuredGrid:
    """A frame with a field of every kind."""
    grid = make_grid(t, numbers=True)
    rng = np.random.default_rng(1)
    for name, dtype in (("bytes", "u1"), ("short", "i2"), ("counts", "u4"), ("ids", "i8"), ("half", "f4")):
        grid.point_data[name] = rng.integers(0, 99, len(POINTS)).astype(dtype)
    grid.cell_data["stress"] = rng.normal(size=(len(CELLS), 9))
    grid.cell_data["plane"] = rng.normal(size=(len(CELLS), 2))
    grid.field_data["TimeValue"] = [t]
    grid.field_data["three"] = np.array([[1.0, 2.0, 3.0]])
    grid.field_data["words"] = ["two", "words <&>"]
    return grid


def save_grid(grid, path, *, mode="inline", compressor="zlib", order="little", ids=64, header=32):
    writer = vtk.vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(grid)
    {"inline": writer.SetDataModeToBinary, "ascii": writer.SetDataModeToAscii,
     "appended": writer.SetDataModeToAppended}[mode]()  # fmt: skip
    {"zlib": writer.SetCompressorTypeToZLib, "none": writer.SetCompressorTypeToNone,
     "lz4": writer.SetCompressorTypeToLZ4}[compressor]()  # fmt: skip
    writer.SetByteOrderToBigEndian() if order == "big" else writer.SetByteOrderToLittleEndian()
    writer.SetIdTypeToInt32() if ids == 32 else writer.SetIdTypeToInt64()
    writer.SetHeaderTypeToUInt32() if header == 32 else writer.SetHeaderTypeToUInt64()
    writer.SetBlockSize(1024)  # several blocks an array, the last one shorter
    assert writer.Write()
    return path


def assert_same(path):
    mine, theirs = read_inline(path), readers.read_grid(path)
    assert mine is not None and mine.count == len(theirs.points)
    for name in ("points", "types", "offsets", "connectivity"):
        a, b = getattr(mine, name), getattr(theirs, name)
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
    for kind in ("point_data", "cell_data", "field_data"):
        a, b = getattr(mine, kind), getattr(theirs, kind)
        assert set(a) == set(b)
        for name in a:
            assert a[name].shape == b[name].shape and a[name].flags.writeable
            assert a[name].dtype == b[name].dtype
            np.testing.assert_array_equal(a[name], b[name])


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("header", [32, 64])
@pytest.mark.parametrize("compressor", ["zlib", "none"])
def test_numbers_equal_those_of_vtk(tmp_path, order, header, compressor):
    ids = 32 if order == "big" else 64
    assert_same(
        save_grid(make_rich_grid(), tmp_path / "f.vtu", order=order, header=header, compressor=compressor, ids=ids)
    )


def test_files_of_other_writers_equal_those_of_vtk(tmp_path):
    import meshio

    make_rich_grid().save(tmp_path / "pyvista.vtu")
    assert_same(tmp_path / "pyvista.vtu")
    data = {"u": move_points(0.3), "k": np.arange(len(POINTS))}
    for compression in ("zlib", None):
        meshio.write(tmp_path / "m.vtu", meshio.Mesh(POINTS, [("tetra", CELLS)], data), compression=compression)
        assert_same(tmp_path / "m.vtu")
    dataset = open_lazily(write_fields(tmp_path))
    dataset.attrs["title"] = "wörds <&>"
    path = write_pvd_series(dataset, tmp_path / "ours.pvd")
    for frame in sorted((tmp_path / "ours").iterdir()):
        assert_same(frame)
    assert open_lazily(path).attrs["title"] == "wörds <&>"


@pytest.mark.parametrize("way", [{"mode": "ascii"}, {"mode": "appended"}, {"compressor": "lz4"}])
def test_other_encodings_are_left_to_vtk(tmp_path, way):
    path = save_grid(make_rich_grid(), tmp_path / "f.vtu", **way)
    assert read_inline(path) is None and readers.read_grid(path).point_data["speed"][-1] == 1


def test_ghost_cells_pieces_and_doctypes_are_left_to_vtk(tmp_path):
    grid = make_rich_grid()
    grid.cell_data["vtkGhostType"] = np.zeros(len(CELLS), dtype=np.uint8)
    assert read_inline(save_grid(grid, tmp_path / "ghosts.vtu")) is None
    text = save_grid(make_rich_grid(), tmp_path / "f.vtu").read_text()
    start, end = text.index("<Piece"), text.index("</Piece>") + len("</Piece>")
    for name, changed in {
        "pieces": text[:end] + text[start:end] + text[end:],
        "doctype": text.replace("?>", '?><!DOCTYPE a [<!ENTITY b "c">]>', 1),
        "twice": text.replace('Name="speed"', 'Name="bytes"'),
        "far corner": text.replace('NumberOfPoints="27"', 'NumberOfPoints="9"'),
    }.items():
        (tmp_path / f"{name}.vtu").write_text(changed)
        assert read_inline(tmp_path / f"{name}.vtu") is None, name
    (tmp_path / "f.vtu").write_text(text)
    assert read_inline(tmp_path / "f.vtu") is not None


def long_text(text):
    """Return where the numbers of the array stress begin, which are long enough to be kept from the XML parser."""
    return text.index(">", text.index('Name="stress"')) + 1


def test_numbers_are_found_in_unusual_xml(tmp_path, monkeypatch):
    text = save_grid(make_rich_grid(), tmp_path / "f.vtu", compressor="none").read_text()
    at = long_text(text)
    first = at + len(text[at:]) - len(text[at:].lstrip())
    ways = {
        "comment": text[:at] + '<!-- <a b="c"> -->' + text[at:],
        "references": f"{text[:first]}&#{ord(text[first])};{text[first + 1 :]}",
        "end within": text.replace('Name="stress"', """one='a>"b' other="'>" Name="stress" """),
        "instruction": text.replace("<PointData", "<?a <b>?><PointData", 1),
        "apostrophes": text.replace('Name="stress"', "Name = 'stress'"),
    }
    for name, changed in ways.items():  # VTK itself stumbles on some of these
        assert changed != text
        (tmp_path / f"{name}.vtu").write_text(changed)
        found = read_inline(tmp_path / f"{name}.vtu").cell_data["stress"]
        np.testing.assert_array_equal(found, make_rich_grid().cell_data["stress"])
    parsed = []
    plain = vtu_read.ElementTree.fromstring
    monkeypatch.setattr(vtu_read.ElementTree, "fromstring", lambda content: parsed.append(content) or plain(content))
    (tmp_path / "f.vtu").write_text(text)
    assert_same(tmp_path / "f.vtu")
    assert text[first : first + 300].encode() not in parsed[0]


@pytest.mark.parametrize("said", ["@K", "@ K", "@+K", "@0K", "&#64;K", "@<?x?>K", "@-1", "@99", "@x", "@"])
def test_marks_of_removed_texts_are_refused_in_files(tmp_path, said):
    """K is the mark of another array of the same size, whose numbers would fit."""
    grid = make_rich_grid()
    grid.cell_data["other"] = np.random.default_rng(2).normal(size=(len(CELLS), 9))
    text = save_grid(grid, tmp_path / "f.vtu", compressor="none").read_text()
    at = long_text(text)
    before, after = text[:at], text[text.index("<", at) :]
    other = after[after.index(">", after.index('Name="other"')) + 1 :].split("<")[0].strip()
    (place,) = (k for k, one in vtu_read._take_out_texts((before + after).encode())[1].items() if one == other.encode())
    (tmp_path / "f.vtu").write_text(before + said.replace("K", place.decode()[1:]) + after)
    assert read_inline(tmp_path / "f.vtu") is None


def test_many_attributes_take_little_memory(tmp_path):
    """The regular expression that finds the ends of attributes keeps hundreds of bytes of each."""
    attributes = ' a=""' * 200_000  # which no parser takes
    (tmp_path / "f.vtu").write_text(f'<?xml version="1.0"?><VTKFile{attributes}>{"A" * 300}</VTKFile>')
    tracemalloc.start()
    assert read_inline(tmp_path / "f.vtu") is None
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20 * (tmp_path / "f.vtu").stat().st_size


@pytest.mark.parametrize("name", ["types", "connectivity", "Points"])
def test_arrays_of_no_components_are_left_to_vtk(tmp_path, name):
    text = save_grid(make_rich_grid(), tmp_path / "f.vtu").read_text()
    start = text.index(f'Name="{name}"')
    end = text.index(">", start)
    none = text[start:end].replace(' NumberOfComponents="3"', "") + ' NumberOfComponents="0"'
    (tmp_path / "f.vtu").write_text(text[:start] + none + text[end:])
    assert read_inline(tmp_path / "f.vtu") is None
    if name == "Points":
        with pytest.raises(SeriesError, match=r"f\.vtu: cannot be read \("):
            read_series(tmp_path / "f.vtu")
    else:  # it does not look at their components
        assert len(read_series(tmp_path / "f.vtu")) == 1


def test_cells_of_floats_are_left_to_vtk(tmp_path):
    text = save_grid(make_rich_grid(), tmp_path / "f.vtu").read_text()
    changed = text.replace('"Int64" IdType="1" Name="conn', '"Float64" Name="conn')
    assert changed != text
    (tmp_path / "f.vtu").write_text(changed)
    assert read_inline(tmp_path / "f.vtu") is None


def test_a_long_text_does_not_lengthen_all_texts_beyond_the_limit(tmp_path, monkeypatch):
    words = read_inline(save_grid(make_rich_grid(), tmp_path / "f.vtu")).field_data
    longest = 4 * 2 * len("words <&>")
    monkeypatch.setattr(vtu_read, "_LEAST_BYTES", longest)
    assert words["words"].nbytes == longest
    monkeypatch.setattr(vtu_read, "_LEAST_BYTES", longest - 1)
    with pytest.raises(SeriesError, match="2 texts that differ too much"):
        words["words"]


@pytest.mark.parametrize(
    ("old", "new"),
    [('NumberOfPoints="27"', 'NumberOfPoints="-27"'), ('version="1.0"?', 'version="1.0" encoding="nonsense"?')],
)
def test_nonsense_is_reported_on_one_line(tmp_path, old, new):
    text = save_grid(make_rich_grid(), tmp_path / "f.vtu").read_text()
    changed = text.replace(old, new, 1).replace('Components="3"', 'Components="-3"')
    assert old in text
    (tmp_path / "f.vtu").write_text(changed)
    assert read_inline(tmp_path / "f.vtu") is None
    with pytest.raises(SeriesError, match=r"f\.vtu: .+") as caught:
        read_series(tmp_path / "f.vtu")
    assert "\n" not in str(caught.value)


def test_files_beyond_memory_are_left_to_the_sandbox(tmp_path, monkeypatch):
    path = save_grid(make_rich_grid(), tmp_path / "f.vtu")
    monkeypatch.setattr(vtu_read, "_LEAST_BYTES", 1000)
    monkeypatch.setattr(vtu_read, "_BYTES_PER_BYTE", 0)
    assert read_inline(path) is None


def test_a_large_file_is_left_unread_to_the_sandbox(tmp_path, monkeypatch):
    path = save_grid(make_rich_grid(), tmp_path / "f.vtu")
    monkeypatch.setattr(vtu_read, "_LARGEST", path.stat().st_size)
    assert read_inline(path) is not None
    monkeypatch.setattr(vtu_read, "_LARGEST", path.stat().st_size - 1)
    monkeypatch.setattr(vtu_read.ElementTree, "fromstring", lambda _: pytest.fail("read"))
    assert read_inline(path) is None
    assert read_grid(path).point_data["speed"][-1] == 1


@pytest.mark.parametrize("many", ["<a/>" * 300_000, "<a " + " ".join(f"a{i}=''" for i in range(150_000)) + "/>"])
def test_countless_elements_are_left_to_the_sandbox(tmp_path, monkeypatch, many):
    path = save_grid(make_rich_grid(), tmp_path / "f.vtu")
    path.write_text(path.read_text().replace("<PointData", many + "<PointData", 1))
    assert read_inline(path) is not None
    monkeypatch.setattr(vtu_read, "_MOST_MARKS", 250_000)
    assert read_inline(path) is None


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_entities_in_wide_characters_are_not_read_inline(tmp_path, encoding):
    text = (
        save_grid(make_rich_grid(), tmp_path / "f.vtu")
        .read_text()
        .partition("?>")[2]
        .replace('Name="speed"', 'Name="&b;"')
    )
    (tmp_path / "f.vtu").write_bytes(f'<!DOCTYPE a [<!ENTITY b "c">]>{text}'.encode(encoding))
    assert read_inline(tmp_path / "f.vtu") is None
    with pytest.raises(SeriesError, match="UTF-16"):
        read_grid(tmp_path / "f.vtu")


def collect_arrays(grid):
    kinds = ("point_data", "cell_data", "field_data")
    return {"points": grid.points, **{f"{k} {name}": a for k in kinds for name, a in getattr(grid, k).items()}}


def test_damage_is_reported_and_never_read_as_numbers(tmp_path):
    """Any byte changed: refused, left to VTK, or the very numbers (as in names and spaces)."""
    content = save_grid(make_rich_grid(), tmp_path / "f.vtu", header=64).read_bytes()
    whole = collect_arrays(read_inline(tmp_path / "f.vtu"))
    rng, refused = random.Random(3), 0
    for _ in range(300):
        changed = bytearray(content)
        changed[rng.randrange(len(changed))] = rng.randrange(256)
        (tmp_path / "bad.vtu").write_bytes(changed)
        try:
            grid = read_inline(tmp_path / "bad.vtu")
            read = {} if grid is None else collect_arrays(grid)
        except SeriesError as error:
            assert str(error).startswith(str(tmp_path / "bad.vtu")) and "\n" not in str(error)
            refused += 1
            continue
        for name in read.keys() & whole.keys():
            same_kind = read[name].dtype == whole[name].dtype and read[name].shape == whole[name].shape
            assert not same_kind or np.array_equal(read[name], whole[name])
    assert refused > 20


def test_a_damaged_field_leaves_the_others_readable(tmp_path):
    source = write_series(tmp_path, numbers=True)
    path = tmp_path / "f1.vtu"
    text = path.read_text()
    start = text.index(">", text.index('Name="speed"')) + 60
    path.write_text(text[:start] + ("A" if text[start] != "A" else "B") + text[start + 1 :])
    assert len(list(read_series(source))) == 3
    dataset = open_lazily(source)
    assert np.isfinite(dataset["displacement"].values).all()
    with pytest.raises(SeriesError, match=r"f1\.vtu: cannot be read .the array speed"):
        dataset["speed"].load()


def test_reading_all_fields_reads_each_frame_once(tmp_path, monkeypatch):
    counts = []
    read = vtu_read._parse_file
    monkeypatch.setattr(vtu_read, "_parse_file", lambda file: counts.append(file.name) or read(file))
    source = write_series(tmp_path, numbers=True)
    open_lazily(source).load()
    assert counts.count("f1.vtu") <= 2  # once to see whether the points move
    counts.clear()
    monkeypatch.setattr(engine, "_CACHE_BYTES", 0)  # a series that is too long
    open_lazily(source).load()
    assert counts.count("f1.vtu") == 4  # once more to see its fields


@pytest.mark.parametrize("mode", ["inline", "appended"])
def test_memory_counts_points_and_shares_cells(tmp_path, mode):
    for i in range(12):
        save_grid(make_grid(i / 10), tmp_path / f"f{i:02}.vtu", mode=mode, compressor="none")
    store = engine.FrameStore(read_series(tmp_path), SerializableLock())
    grids = [store.read_grid(i) for i in range(12)]
    size = grids[0].nbytes
    assert POINTS.nbytes <= size < 1.5 * POINTS.nbytes  # in base64 where it is inline
    for name in ("types", "offsets", "connectivity"):
        assert len({id(getattr(grid, name)) for grid in grids}) == 1
    store = engine.FrameStore(read_series(tmp_path), SerializableLock(), capacity=5 * size)
    for i in range(12):
        store.read_grid(i)
        assert len(store._cache) == min(i + 1, 5)


def test_fields_of_a_frame_with_other_cells_are_missing(tmp_path):
    source = write_series(tmp_path, numbers=True)
    cells = CELLS.copy()
    cells[0] = cells[1]
    grid = pyvista.UnstructuredGrid({10: cells}, move_points(0.1))
    grid.point_data["speed"] = np.zeros(len(POINTS))
    grid.save(tmp_path / "f1.vtu")
    speed = open_lazily(source)["speed"].load()
    assert np.isnan(speed[1]).all() and not np.isnan(speed[2]).any()


def test_any_part_of_a_field_can_be_read(tmp_path):
    dataset, whole = open_lazily(write_fields(tmp_path)), open_lazily(write_fields(tmp_path)).load()
    for key in ({"time": 1}, {"node": [5, 2, 2]}, {"node": 3, "axis": [0, 2]}, {"time": slice(None, None, -1)},
                {"time": [2, 0], "node": slice(1, 9, 3), "axis": 1}, {"time": [], "node": 3}):  # fmt: skip
        xarray.testing.assert_identical(dataset["displacement"].isel(key), whole["displacement"].isel(key))


def test_points_of_the_body_are_probed(tmp_path):
    dataset = open_lazily(write_fields(tmp_path))
    points = np.array([[0.3, 1.2, 0.7], [2, 2, 2], [0, 0, 0], [1.99, 0.01, 1.5]])
    found = dataset.deformation.probe("displacement", points)
    assert found.dims == ("time", "point", "axis") and found.attrs.items() < dataset["displacement"].attrs.items()
    assert found.values == pytest.approx(np.stack([points * 0.5 * t for t in TIMES]), abs=1e-13)
    outside = dataset.deformation.probe("displacement", [[0.3, 1.2, 0.7], [0, 0, 2.01]])
    assert np.isnan(outside.values[:, 1]).all() and np.isfinite(outside.values[:, 0]).all()
    centres = POINTS[CELLS].mean(axis=1)
    ratio = dataset.deformation.volume_ratio()
    xarray.testing.assert_equal(dataset.deformation.probe(ratio, centres), ratio.rename(cell="point"))
    assert np.isnan(dataset.deformation.probe(ratio, [9, 9, 9]).values).all()
    assert dataset.deformation.probe(ratio[0], centres[3]).dims == ("point",)
    with pytest.raises(SeriesError, match="neither nodes nor cells"):
        dataset.deformation.probe(ratio.mean("cell"), centres)
    with pytest.raises(SeriesError, match=r"\(p, 3\), not \(1, 2\)"):
        dataset.deformation.probe("displacement", [1, 2])


def test_probing_chunks_of_dask(tmp_path):
    pytest.importorskip("dask")
    points = [[0.3, 1.2, 0.7]]
    lazy = open_lazily(write_fields(tmp_path), chunks={}).deformation.probe("displacement", points)
    assert lazy.chunks is not None
    assert lazy.values == pytest.approx(
        open_lazily(write_fields(tmp_path)).deformation.probe("displacement", points).values
    )


def test_cells_are_extracted_with_their_nodes(tmp_path):
    dataset = open_lazily(write_fields(tmp_path))
    chosen = [7, 2]
    part = dataset.deformation.extract(chosen)
    assert part.sizes["cell"] == 2 and part.sizes["node"] == len(np.unique(CELLS[chosen]))
    xarray.testing.assert_equal(part.deformation.volume_ratio(), dataset.deformation.volume_ratio().isel(cell=chosen))
    mask = np.isin(np.arange(len(CELLS)), chosen)
    assert dataset.deformation.extract(mask)["connectivity"].attrs == dataset["connectivity"].attrs
    xarray.testing.assert_identical(open_lazily(part.deformation.to_pvd(tmp_path / "part.pvd")), part)


def test_a_series_that_is_not_inline_is_a_dataset_too(tmp_path):
    for i, t in enumerate(TIMES):
        save_grid(make_rich_grid(t), tmp_path / f"f{i}.vtu", mode="appended")
    source = write_pvd(tmp_path, [(t, f"f{i}.vtu") for i, t in enumerate(TIMES)])
    appended = open_lazily(source).load()
    for i, t in enumerate(TIMES):
        save_grid(make_rich_grid(t), tmp_path / f"f{i}.vtu")
    xarray.testing.assert_identical(open_lazily(source).load(), appended)
