"""Series as other programs leave them: every situation gives its right value, or a question that names the choices."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import xarray

import pipeline
from pipeline.cli import main
from pipeline.errors import SeriesError
from pipeline.run.measures import measure
from pipeline.series import Series
from pipeline.series.xarray_plugin import SeriesBackend
from tests.foreign import displacements, fields, listings, partitions, xdmf_files

Check = Callable[[Path, Path], None]  # (path of the series, empty folder)
STRETCH = (1.0, 1.2, 1.5)


class Situation(NamedTuple):
    """A series that `make` writes into a folder, the path of it there, and the check of the right value."""

    name: str
    make: Callable[[Path], None]
    path: str
    check: Check


# Checks


def ratios(*expected: float, times=None, cells: int | None = None, note: str = "", rtol=1e-9, **options) -> Check:
    """Every cell has the expected volume ratio, one a frame."""

    def check(path: Path, _out: Path) -> None:
        series = pipeline.read_series(path, **options)
        measured = [measure(frame)["volume_ratio"] for frame in series]
        assert len(measured) == len(expected)
        assert cells is None or len(series.mesh.rest_volumes) == cells
        for ratio, value in zip(measured, expected, strict=True):
            assert ratio == pytest.approx(value, rel=rtol)
        assert times is None or series.times == pytest.approx(times)
        assert_note(series, note)

    return check


def volumes(*expected: float, worst: float, cells: int, note: str = "") -> Check:
    """The body has the expected total volumes, one a frame, and the last frame this largest ratio."""

    def check(path: Path, _out: Path) -> None:
        series = pipeline.read_series(path)
        measured = [measure(frame) for frame in series]
        assert [float(values["total_volume"]) for values in measured] == pytest.approx(expected, rel=1e-9)
        assert len(series.mesh.rest_volumes) == cells
        assert measured[-1]["volume_ratio"].max() == pytest.approx(worst, rel=1e-9)
        assert_note(series, note)

    return check


def assert_note(series: Series, words: str) -> None:
    assert not words or any(words in note for note in series.notes), series.notes


def asks(*words: str, **options: str) -> Check:
    """The series is refused with these words in one line, and the program ends with exit code 2."""

    def check(path: Path, out: Path) -> None:
        with pytest.raises(SeriesError) as caught:
            for frame in pipeline.read_series(path, **options):
                measure(frame)
        assert all(word in str(caught.value) for word in words), caught.value
        arguments = [word for name, value in options.items() for word in (f"--{name}", value)]
        assert main(["analyze", str(path), "--out", str(out), *arguments]) == 2

    return check


def opens(**expected: object) -> Check:
    """The dataset has variables of these values, one a frame, equal for every node or cell; None: any values."""

    def check(path: Path, _out: Path) -> None:
        with xarray.open_dataset(path, engine=SeriesBackend) as dataset:
            for name, values in expected.items():
                assert name in dataset, list(dataset)
                if values is not None:
                    loaded = dataset[name].load()
                    assert "time" in loaded.dims
                    for k, value in enumerate(values):
                        assert np.asarray(loaded.isel(time=k).values, dtype=float) == pytest.approx(value, rel=1e-12)

    return check


def both(*checks: Check) -> Check:
    def check(path: Path, out: Path) -> None:
        for one in checks:
            one(path, out)

    return check


def displaced(*expected: float) -> Check:
    """The dataset's displacement has these largest values, one a frame."""

    def check(path: Path, _out: Path) -> None:
        with xarray.open_dataset(path, engine=SeriesBackend) as dataset:
            u = dataset["displacement"].load()
            assert u.max(["node", "axis"]).values == pytest.approx(expected, rel=1e-12)

    return check


def ends_as_nan(path: Path, out: Path) -> None:
    """The frames before the last are measured; the last has none."""
    analysis = pipeline.analyze(pipeline.read_series(path), out)
    with xarray.open_dataset(out / "statistics.nc") as dataset:
        ratio = dataset["volume_ratio"].load()
    assert ratio.isel(time=2).values == pytest.approx(1.5, rel=1e-9)
    assert len(ratio.time) == 3 or np.isnan(ratio.isel(time=3)).all()
    assert any("finite" in note or "NaN" in note for note in analysis.notes), analysis.notes


def measures_whole_body(path: Path, out: Path) -> None:
    """Total volumes go on after the cells have changed; the note says from where on cells have no numbers."""
    analysis = pipeline.analyze(pipeline.read_series(path), out)
    with xarray.open_dataset(out / "statistics.nc") as dataset:
        assert dataset["total_volume"].values == pytest.approx([2.0, 2.2, 2.4], rel=1e-9)
        assert dataset["volume_ratio"].isel(time=1).values == pytest.approx(1.1, rel=1e-9)
        assert np.isnan(dataset["volume_ratio"].isel(time=2)).all()
    assert any("0.2" in note for note in analysis.notes), analysis.notes


def warns_of_precision(path: Path, _out: Path) -> None:
    """Single precision so far from the origin cannot resolve the cells: a note says so."""
    series = pipeline.read_series(path)
    assert any("precision" in note for note in series.notes), series.notes


def compares(other: str) -> Check:
    """A difference of bodies that are not the same at rest is refused, or noted."""

    def check(path: Path, out: Path) -> None:
        series = [pipeline.read_series(path), pipeline.read_series(path.parent.parent / other / "s.pvd")]
        try:
            comparison = pipeline.compare(series, out, difference=True)
        except SeriesError as error:
            assert "rest" in str(error) or "same" in str(error)
            arguments = ["compare", str(path), str(path.parent.parent / other / "s.pvd"), "--difference"]
            assert main([*arguments, "--out", str(out)]) == 2
        else:
            assert any("rest" in note for note in comparison.notes), comparison.notes

    return check


D, F, L, P, X = displacements, fields, listings, partitions, xdmf_files
TENTHS = (0.0, 0.1, 0.2)
SITUATIONS = [
    # displacement and rest state
    Situation("baseline", D.baseline, "s.pvd", ratios(*STRETCH, times=TENTHS, cells=12)),
    Situation("point_and_cell_displacement", D.cell_field_displacement, "s.pvd", ratios(*STRETCH)),
    Situation("cell_displacement_alone", D.cell_field_displacement, "cells_only.pvd", opens(displacement_cell=None)),
    Situation("deformed_from_step_1", D.deformed_from_step_1, "s.pvd", ratios(1.2, 1.5, 1.8)),
    Situation("displacement_as_in_the_file", D.deformed_from_step_1, "lower.pvd", displaced(0.4, 1.0, 1.6)),
    Situation("own_points", D.own_points, "s.pvd", ratios(*STRETCH, cells=12)),
    Situation("three_scalars", D.three_scalars, "s.pvd", ratios(*STRETCH)),
    Situation("displacement_not_in_first_frame", D.not_in_first_frame, "s.pvd", ratios(*STRETCH)),
    Situation("noise_in_rest_points", D.noise_in_rest_points, "s.pvd", ratios(*STRETCH)),
    Situation("two_vectors", D.two_vectors, "s.pvd", asks("D", "U", "displacement")),
    Situation("two_vectors_with_the_answer", D.two_vectors, "s.pvd", ratios(*STRETCH, displacement="D")),
    Situation("flow_called_u", D.flow, "s.pvd", asks("U", "none")),
    Situation("flow_with_the_answer", D.flow, "s.pvd", ratios(1.0, 1.0, 1.0, displacement="none")),
    Situation("d_v_p", D.vectors_named_d_v_p, "s.pvd", asks("d", "displacement")),
    Situation("d_v_p_with_the_answer", D.vectors_named_d_v_p, "s.pvd", ratios(*STRETCH, displacement="d")),
    Situation("single_precision_far_away", D.single_precision_far_away, "s.pvd", warns_of_precision),
    Situation("not_a_number", D.not_a_number, "s.pvd", ends_as_nan),
    # fields
    Situation("integers_first", F.integers_first, "s.pvd", opens(damage=(0, 0.3, 0.6), temp=(0, 0.5, 1.0))),
    Situation("types_grow", F.types_grow, "s.pvd",
              opens(material=(7, 300, 1000), pressure=(1e8, 1e8 + 1.5, 1e8 + 3), id=(5, 2**40, 2**40))),
    Situation("field_and_field_data_named_time", F.names_of_dimensions, "f.pvd", ratios(*STRETCH)),
    Situation("dataset_with_names_of_dimensions", F.names_of_dimensions, "f.pvd", opens(rest_position=None)),
    Situation("field_data_named_time", F.names_of_dimensions, "g.pvd", opens(rest_position=None)),
    Situation("point_field_named_node", F.names_of_dimensions, "h.pvd", opens(rest_position=None)),
    Situation("cell_fields_named_like_ours", F.names_of_dimensions, "i.pvd", ratios(*STRETCH)),
    Situation("same_name_on_points_and_cells", F.same_name_on_points_and_cells, "s.pvd",
              opens(T=(300, 301, 302), T_cell=(500, 501, 502))),
    Situation("odd_names", F.odd_names, "s.pvd", opens(**{"Von Mises_[MPa]": (0, 1, 2), "σ": (0, 0, 0)})),
    # listings
    Situation("equal_times", L.equal_times, "", ratios(*STRETCH)),
    Situation("many_digits", L.many_digits, "", ratios(1.0, 1.00999999, 1.01, 1.1)),
    Situation("names_with_decimals", L.names_with_decimals, "", ratios(1.0, 1.05, 1.1, 1.15)),
    Situation("rounded_times", L.rounded_times, "s.pvd", ratios(1.0, 1.1, 1.2, 1.8, 1.3)),
    Situation("paths_of_windows", L.paths, "backslash.pvd", ratios(*STRETCH)),
    Situation("paths_of_windows_with_dot", L.paths, "dotback.pvd", ratios(*STRETCH)),
    Situation("paths_absolute", L.paths, "absolute.pvd", ratios(*STRETCH)),
    Situation("paths_upwards", L.paths, "pvd/up.pvd", ratios(*STRETCH)),
    Situation("index_without_timestep", L.paths, "nostep.pvd", ratios(1.0)),
    Situation("index_with_decimal_comma", L.paths, "comma.pvd", ratios(*STRETCH, times=(0.5, 1.5, 2.5))),
    Situation("index_of_killed_writer", L.broken_index, "killed.pvd", ratios(*STRETCH, displacement="d")),
    Situation("index_with_fortran_numbers", L.broken_index, "dots.pvd",
              ratios(*STRETCH, times=TENTHS, displacement="d")),
    Situation("legacy_series", L.legacy_and_multiblock, "Solid-Mesh.vtk.series", ratios(*STRETCH, times=TENTHS)),
    Situation("numbered_legacy_pattern", L.legacy_and_multiblock, "Solid-Mesh.dt*.vtk", ratios(*STRETCH)),
    Situation("multiblock_pattern", L.legacy_and_multiblock, "case_*.vtm", ratios(*STRETCH)),
    Situation("multiblock_in_index", L.legacy_and_multiblock, "vtm.pvd", ratios(*STRETCH)),
    Situation("suffixes_in_capitals", L.legacy_and_multiblock, "S.PVD", ratios(*STRETCH)),
    Situation("steps_in_one_vtu", L.steps_in_one_vtu, "all.vtu", ratios(*STRETCH)),
    # partitions and other meshes
    Situation("numbered_parts", P.numbered_parts, "s.pvd", volumes(2, 2.4, 3, worst=1.5, cells=12)),
    Situation("unnumbered_parts", P.unnumbered_parts, "nopart.pvd", volumes(2, 2.2, 2.5, worst=1.5, cells=12)),
    Situation("parts_all_0", P.unnumbered_parts, "part0.pvd", volumes(2, 2.2, 2.5, worst=1.5, cells=12)),
    Situation("overlap_marked", P.overlaps, "a.pvd", volumes(3, 3.6, 4.5, worst=1.5, cells=18)),
    Situation("overlap_marked_by_rank", P.overlaps, "b.pvd", volumes(3, 3.6, 4.5, worst=1.5, cells=18)),
    Situation("overlap_unmarked", P.overlaps, "c.pvd", volumes(3, 3.6, 4.5, worst=1.5, cells=18)),
    Situation("missing_piece", P.missing_piece, "u.pvd", asks("u_p1_0.vtu")),
    Situation("permuted_cells", P.permuted_cells, "s.pvd", ratios(*STRETCH)),
    Situation("compare_meters_with_millimeters", P.different_bodies, "m/s.pvd", compares("mm")),
    Situation("compare_different_bodies", P.different_bodies, "m/s.pvd", compares("other")),
    Situation("remeshed", P.remeshed, "s.pvd", measures_whole_body),
    # kinds of cells
    Situation("lagrange_tetrahedra_of_order_1", P.lagrange_of_order_1, "u.pvd", ratios(*STRETCH)),
    Situation("lagrange_triangles_of_order_1", P.lagrange_of_order_1, "t.pvd", ratios(*STRETCH)),
    Situation("mixed_orientation", P.mixed_orientation, "f.pvd", ratios(*STRETCH)),
    Situation("mixed_orientation_in_the_plane", P.mixed_orientation, "g.pvd", ratios(*STRETCH)),
    Situation("tetrahedra_and_hexahedra", P.tetrahedra_and_hexahedra, "s.pvd",
              volumes(2, 2.4, 3, worst=1.5, cells=7)),
    Situation("quadratic_tetrahedra", P.quadratic_tetrahedra, "s.pvd", ratios(1.0, 1.2, 1.5)),
    Situation("vertical_plane", P.vertical_plane, "s.pvd", ratios(*STRETCH)),
    # XDMF
    Situation("xdmf_displacement_first", X.two_collections, "u_then_stress.xdmf", ratios(*STRETCH)),
    Situation("xdmf_stress_first", X.two_collections, "stress_then_u.xdmf", ratios(*STRETCH)),
    Situation("xdmf_binary_little_endian", X.binary, "little.xdmf", ratios(*STRETCH)),
    Situation("xdmf_binary_big_endian", X.binary, "big.xdmf", ratios(*STRETCH)),
    Situation("xdmf_binary_with_seek", X.binary, "seek.xdmf", ratios(*STRETCH)),
]  # fmt: skip


@pytest.mark.parametrize("situation", SITUATIONS, ids=lambda situation: situation.name)
def test_a_foreign_series_gives_its_right_value(folders, tmp_path, situation):
    folder = folders(situation.make)
    situation.check(folder / situation.path if situation.path else folder, tmp_path / "out")
