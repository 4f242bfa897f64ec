"""Two readers, no disagreement: generated files in every layout give the arrays that were written.

`make fuzz` tries 10 000 (PIPELINE_FUZZ); a failure names the kind of file and the number of the example.
"""

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import SeriesError
from pipeline.formats.sandbox import SHARED_READER
from pipeline.formats.vtu_read import read_inline
from pipeline.series.files.frame_files import read_grid, read_times
from pipeline.series.files.listing import list_frames
from tests.formats import generated_series as S
from tests.formats import generated_vtk as V
from tests.formats.generated_content import Content, find_difference

TOTAL = max(2000, int(os.environ.get("PIPELINE_FUZZ", "0")))
Write = Callable[[np.random.Generator, Path], Content | S.Steps]
# suffix, writer, share of the examples
KINDS: dict[str, tuple[str, Write, float]] = {
    "vtu_by_hand": (".vtu", V.write_vtu_by_hand, 0.25),
    "vtu_inline": (".vtu", V.write_inline_vtu, 0.1),
    "vtu_by_vtk": (".vtu", V.write_vtu_by_vtk, 0.2),
    "vtp": (".vtp", V.write_vtp, 0.07),
    "legacy": (".vtk", V.write_legacy, 0.13),
    "pvtu": (".pvtu", V.write_pvtu, 0.08),
    "xdmf": (".xdmf", S.write_xdmf, 0.1),
    "vtkhdf": (".vtkhdf", S.write_vtkhdf, 0.03),
    "vtm": (".vtm", V.write_vtm, 0.03),
    "index": (".pvd", S.write_index, 0.03),
}
BATCH = 50


def batches() -> list[tuple[str, range]]:
    rows = []
    for kind, (_, _, share) in KINDS.items():
        count = round(TOTAL * share)
        rows += [(kind, range(k, min(k + BATCH, count))) for k in range(0, count, BATCH)]
    return rows


def compare(path: Path, expected: Content | S.Steps) -> str:
    """The first difference between a file and what it must give; empty if there is none."""
    if isinstance(expected, Content):
        return find_difference(read_grid(path), expected)
    if path.suffix == ".pvd":
        return compare_index(path, expected)
    times = list(read_times(path).values)
    if times != (expected.times or []):
        return f"times {times} instead of {expected.times}"
    for k, content in enumerate(expected.contents):
        if difference := find_difference(read_grid(path, k), content):
            return f"step {k}: {difference}"
    return ""


def compare_index(path: Path, expected: S.Steps) -> str:
    """The first difference between the frames of an index and what they must give."""
    members = list_frames(path, strict=True).members
    times = [member.time for member in members]
    if times != expected.times:
        return f"times {times} instead of {expected.times}"
    for member, content in zip(members, expected.contents, strict=True):
        if difference := find_difference(read_grid(member.file, member.step), content):
            return f"{member.file.name}: {difference}"
    return ""


@pytest.mark.parametrize(("kind", "numbers"), batches(), ids=lambda v: v if isinstance(v, str) else f"{v.start}")
def test_a_file_gives_the_arrays_that_were_written(tmp_path, kind, numbers):
    suffix, write, _ = KINDS[kind]
    faults = []
    for number in numbers:
        folder = tmp_path / str(number)
        folder.mkdir()
        path = folder / f"it{suffix}"
        expected = write(np.random.default_rng([number, *kind.encode()]), path)
        try:
            difference = compare(path, expected)
        except SeriesError as error:
            difference = str(error)
        if difference:
            faults.append(f"{kind} {number}: {difference}")
        else:
            shutil.rmtree(folder)
    assert not faults, "\n".join(faults)


# Damaged files: our own readers may refuse what VTK reads, but never give other numbers


def read_arrays_by_vtk(file: Path) -> tuple:
    """The points, types, connectivity and fields that VTK gives without an error; called in the guarded child."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    reader, errors = vtkXMLUnstructuredGridReader(), []
    reader.AddObserver("ErrorEvent", lambda *_: errors.append("error"))
    reader.SetFileName(str(file))
    reader.Update()
    grid = reader.GetOutput()
    if errors or reader.GetErrorCode() or not grid.GetNumberOfCells():
        raise SeriesError("VTK reports an error")
    fields = [
        {
            data.GetArrayName(k): vtk_to_numpy(data.GetArray(k))
            for k in range(data.GetNumberOfArrays())
            if data.GetArray(k)
        }
        for data in (grid.GetPointData(), grid.GetCellData())
    ]
    cells = grid.GetCells()
    arrays = (cells.GetOffsetsArray(), cells.GetConnectivityArray())
    points = vtk_to_numpy(grid.GetPoints().GetData()).astype(np.float64)
    return points, vtk_to_numpy(grid.GetCellTypes()), *(vtk_to_numpy(a).astype(np.int64) for a in arrays), *fields


def damage(data: bytes, random: np.random.Generator) -> bytes:
    """Change one to three bytes, or one number, or cut a few bytes out."""
    kind = random.integers(4)
    at = int(random.integers(len(data)))
    if kind == 0:
        return data[:at] + data[at + int(random.integers(1, 9)) :]
    if kind == 1:
        found = list(re.finditer(rb"(?<=[\"'])\d+(?=[\"'])", data))
        one = found[int(random.integers(len(found)))]
        number = str(random.choice(["0", "1", "2", "3", "7", "100", "4294967296"])).encode()
        return data[: one.start()] + number + data[one.end() :]
    out = bytearray(data)
    for place in random.integers(len(data), size=random.integers(1, 4)):
        out[place] = int(random.choice(list(b'ABCabc019+/=<" ')))
    return bytes(out)


DAMAGED = round(TOTAL * 0.2)


@pytest.mark.parametrize(
    "numbers", [range(k, min(k + BATCH, DAMAGED)) for k in range(0, DAMAGED, BATCH)], ids=lambda r: f"{r.start}"
)
def test_a_damaged_file_is_refused_or_gives_what_vtk_gives(tmp_path, numbers):
    faults, read = [], 0
    for number in numbers:
        random = np.random.default_rng([number, 77])
        path = tmp_path / f"it_{number}.vtu"
        V.write_inline_vtu(random, path)
        path.write_bytes(damage(path.read_bytes(), random))
        grid = read_inline(path)
        if grid is None:  # VTK reads it for us: there is one reader
            continue
        try:
            for fields in (grid.point_data, grid.cell_data, grid.field_data):
                dict(fields)  # decodes them
            grid.points.sum()
        except SeriesError:
            continue
        read += 1
        try:
            points, types, offsets, connectivity, *fields = SHARED_READER.read(
                "tests.formats.test_differential:read_arrays_by_vtk", path, error=SeriesError
            )
        except SeriesError as error:
            faults.append(f"{number}: read, but VTK refuses it ({error})")
            continue
        if difference := find_difference(
            grid, Content(points, types, offsets, connectivity, *fields, dict(grid.field_data))
        ):
            faults.append(f"{number}: {difference}")
    assert not faults, "\n".join(faults)
