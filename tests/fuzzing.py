"""Bad input by the thousand: case files with one fault a key, mesh and series files with mutated bytes.

Everything is drawn from a `random.Random`, so that a number identifies an example. `batches(kind)` are the numbers that
the suite tries; `PIPELINE_FUZZ` is their total (500; `make fuzz` tries 10 000).
"""

import copy
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import meshio
import numpy as np
import pyvista
import tomli_w

from pipeline.mesh.shapes import box

TOTAL = int(os.environ.get("PIPELINE_FUZZ", "500"))
SHARES = {"case": 0.5, "mesh": 0.25, "series": 0.25}
BATCH = 25  # examples a test: a failure names its numbers


def batches(kind: str) -> list[range]:
    """The numbers of the examples of a kind, in batches."""
    count = round(TOTAL * SHARES[kind])
    return [range(start, min(start + BATCH, count)) for start in range(0, count, BATCH)]


# Case files with every key

SPIN = {"axis": [0.0, 1.0, 0.0], "rate": 9.0, "center": [0.5, 1.0, 0.5]}
FULL: dict[str, Any] = {
    "name": "beam",
    "mesh": {"shape": "box", "size": [1.0, 3.0, 1.0], "cells": [1, 3, 1], "split": "kuhn"},
    "material": {"youngs_modulus": 1e7, "poisson_ratio": 0.3, "density": 1000.0},
    "supports": [
        {"plane": "y", "at": 3.0, "motion": {"velocity": [0.0, 0.1, 0.0], "spin": SPIN}},
        {"box": [[0.9, -0.1, 0.9], [1.1, 0.1, 1.1]]},
        {"sphere": {"center": [0.0, 0.0, 0.0], "radius": 0.1}},
        {"below": {"axis": "x", "at": -1.0}, "motion": {"velocity": [0.0, 0.0, 0.0]}},
        {"nodes": [0, 1]},
    ],
    "loads": {
        "gravity": [0.0, 0.0, -9.81],
        "body_force": {"value": [0.0, 1.0, 0.0], "factor": 2.0},
        "traction": [{"plane": "y", "at": 0.0, "normal_traction": 10.0}],
    },
    "initial": {"velocity": [0.0, 0.0, -2.0], "factor": 1.5, "spin": SPIN},
    "method": {
        "model": "fixed", "volume_tolerance": 0.01, "law": "corotational", "rotation": "polar",
        "stepper": "backward_euler",
        "iterations": 1, "mass": "consistent", "linear_solver": "auto", "linear_rtol": 1e-8, "tolerance": 1e-9,
        "max_iterations": 50, "tangent": "projected", "inversion": "flip",
    },
    "schedule": {"dt": 0.01, "frames": 2, "steps_per_frame": 1},
    "output": {"format": "vtu", "precision": "float64", "checkpoint_seconds": 10.0, "checkpoint_frames": 1},
    "movie": {"variants": ["a"], "speed": 1.0, "fps": 30, "size": [64, 64], "title": "t"},
    "variants": {"a": {"method.law": "linear"}, "b": {"method.iterations": "converged", "schedule.dt": 0.01}},
}  # fmt: skip
del FULL["supports"][3]  # selects nothing here

Place = tuple[str | int, ...]
FAULTS = ("missing", "type", "range", "inf", "nan", "huge", "empty", "unicode", "duplicate", "unknown")
_TYPES = [True, 7, 1.5, "word", [], {}, [[1.0]], [True, False], {"a": {"b": 1}}, ["y", 2, 1.5]]
_RANGES = [0, 0.0, -1, -1.5, 1, 0.5, 1e-320, 1e-12, 2, 100]
_HUGE = [1e300, -1e300, 1.7e308, 2**31 - 1, 10**12, 2**63 - 1, "9" * 5000, [1e300] * 3, list(range(3000))]
_UNICODE = [
    "ü",
    "名前",
    "‮",
    "\u0000",
    "a/../../b",
    "../out",
    "/etc/passwd",
    "\n",
    "\x7f",
    "😀" * 200,
    "CON",
    "a b",
    ".",
]


def places(value: Any, at: Place = ()) -> list[Place]:
    """Return the path to every table, list and entry of a document."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [at, *(place for key, one in items for place in places(one, (*at, key)))] if at or items else [at]


PLACES = [place for place in places(FULL) if place]


def case_text(number: int) -> str:
    """Return the case file of a number: one to three faults."""
    random = Random(number)
    document = copy.deepcopy(FULL)
    if random.random() < 0.5:  # fewer keys exclude fewer others
        for key in random.sample(["supports", "loads", "initial", "movie", "variants", "output"], 3):
            document.pop(key)
    text = None
    for k in range(random.choice([1, 1, 1, 2, 3])):
        place = PLACES[(number + 31 * k) % len(PLACES)]
        fault = (
            FAULTS[(number // len(PLACES) + 3 * k) % len(FAULTS)] if random.random() < 0.5 else random.choice(FAULTS)
        )
        if fault == "duplicate":
            text = _doubled(document, random)
        elif _reaches(document, place):
            _harm(document, place, fault, random)
    if text is None:
        text = tomli_w.dumps(document)
    return text


def _reaches(document: Any, place: Place) -> bool:
    for key in place:
        inside = isinstance(document, dict) and key in document
        inside |= isinstance(document, list) and isinstance(key, int) and key < len(document)
        if not inside:
            return False
        document = document[key]
    return True


def _harm(document: Any, place: Place, fault: str, random: Random) -> None:
    *above, last = place
    for key in above:
        document = document[key]
    if fault == "missing":
        del document[last]
    elif fault == "unknown" and isinstance(document, dict):
        document[random.choice(["extra", "", "a.b", *_UNICODE])] = random.choice(_TYPES)
    else:
        document[last] = random.choice(
            {
                "type": _TYPES, "range": _RANGES, "inf": [float("inf"), -float("inf")], "nan": [float("nan")],
                "huge": _HUGE, "empty": ["", [], {}], "unicode": _UNICODE, "unknown": ["nothing of that name"],
            }[fault]
        )  # fmt: skip


def _doubled(document: dict[str, Any], random: Random) -> str:
    """Return the text with a line, or a table, twice."""
    lines = tomli_w.dumps(document).splitlines(keepends=True)
    i = random.randrange(len(lines))
    return "".join([*lines[: i + 1], lines[i], *lines[i + 1 :]])


# Files of other tools, mutated

POINTS, CELLS = box((1.0, 2.0, 1.0), (1, 2, 1)).points, box((1.0, 2.0, 1.0), (1, 2, 1)).cells


def _grid(t: float) -> pyvista.UnstructuredGrid:
    grid = pyvista.UnstructuredGrid({10: CELLS}, POINTS * (1 + t))
    grid.point_data["velocity"] = POINTS
    grid.cell_data["part"] = np.arange(len(CELLS), dtype=np.int32)
    grid.field_data["TimeValue"] = [t]
    return grid


def _vtu(path: Path, t: float, *, mode: str = "binary", compress: str = "ZLib") -> None:
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(_grid(t))
    writer.SetDataMode({"ascii": 0, "binary": 1, "appended": 2}[mode])
    writer.SetEncodeAppendedData(False)
    getattr(writer, f"SetCompressorTypeTo{compress}")()
    assert writer.Write()


def _meshio(path: Path, t: float, **options: Any) -> None:
    meshio.write(path, meshio.Mesh(POINTS * (1 + t), [("tetra", CELLS)]), **options)


def _tetgen(path: Path) -> None:
    nodes = "".join(f"{i} {x} {y} {z}\n" for i, (x, y, z) in enumerate(POINTS.tolist()))
    cells = "".join(f"{i} {' '.join(map(str, row))} 1\n" for i, row in enumerate(CELLS.tolist()))
    path.with_suffix(".node").write_text(f"{len(POINTS)} 3 0 0\n{nodes}")
    path.write_text(f"{len(CELLS)} 4 1\n{cells}")


ABAQUS = (
    "*Heading\n*Part, name=A\n*System\n1., 0., 0., 1., 1., 0., 0., 0., 0.\n*Node\n"
    + "".join(f"{i + 1}, {x}, {y}, {z}\n" for i, (x, y, z) in enumerate(POINTS.tolist()))
    + "*Element, type=C3D4, elset=all\n"
    + "".join(f"{i + 1}, {', '.join(str(v + 1) for v in row)}\n" for i, row in enumerate(CELLS.tolist()))
    + "*End Part\n*Assembly, name=B\n*Instance, name=A-1, part=A\n5., 0., 0.\n5., 0., 0., 5., 0., 1., 90.\n"
    "*End Instance\n*Instance, name=A-2, part=A\n*End Instance\n*End Assembly\n"
)
WRITERS: dict[str, tuple[str, Callable[[Path, float], None]]] = {
    "vtu zlib": ("vtu", _vtu),
    "vtu raw": ("vtu", lambda path, t: _vtu(path, t, compress="None")),
    "vtu ascii": ("vtu", lambda path, t: _vtu(path, t, mode="ascii")),
    "vtu appended": ("vtu", lambda path, t: _vtu(path, t, mode="appended")),
    "vtu lz4": ("vtu", lambda path, t: _vtu(path, t, compress="LZ4")),
    "vtu meshio": ("vtu", _meshio),
    "vtk binary": ("vtk", lambda path, t: _grid(t).save(path)),
    "vtk ascii": ("vtk", lambda path, t: _grid(t).save(path, binary=False)),
    "vtk meshio": ("vtk", _meshio),
}
MESHES = WRITERS | {
    "gmsh 2": ("msh", lambda path, t: _meshio(path, t, file_format="gmsh22")),
    "gmsh 4": ("msh", lambda path, t: _meshio(path, t, file_format="gmsh")),
    "gmsh ascii": ("msh", lambda path, t: _meshio(path, t, file_format="gmsh", binary=False)),
    "medit": ("mesh", _meshio),
    "abaqus": ("inp", _meshio),
    "abaqus parts": ("inp", lambda path, t: path.write_text(ABAQUS)),
    "tetgen": ("ele", lambda path, t: _tetgen(path)),
    "nastran": ("bdf", _meshio),
    "xdmf": ("xdmf", lambda path, t: _meshio(path, t, data_format="XML")),
}
_NUMBERS = [b"0", b"-1", b"1", b"2147483648", b"1000000000", b"18446744073709551615", b"9" * 40, b"nan", b"1e400", b""]
_ENTITY = b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'


def mutated(data: bytes, random: Random) -> bytes:
    """Return the bytes of a file after one to three faults, some of them plausible."""
    for _ in range(random.choice([1, 1, 2, 3])):
        data = random.choice(_ACCIDENTS)(data, random) or b"x"
    return data


def _truncated(data: bytes, random: Random) -> bytes:
    return data[: random.randrange(len(data))]


def _flipped(data: bytes, random: Random) -> bytes:
    out = bytearray(data)
    for _ in range(random.choice([1, 1, 4, 16])):
        out[random.randrange(len(out))] ^= 1 << random.randrange(8)
    return bytes(out)


def _renumbered(data: bytes, random: Random) -> bytes:
    """Change a number written in digits: a count, an offset, a node or a length."""
    found = list(re.finditer(rb"-?\d+(\.\d+)?", data))
    if not found:
        return _flipped(data, random)
    one = random.choice(found[: 200 if random.random() < 0.5 else len(found)])
    return data[: one.start()] + random.choice(_NUMBERS) + data[one.end() :]


def _overwritten(data: bytes, random: Random) -> bytes:
    """Replace eight bytes of a binary part by a large, negative or small integer."""
    at = random.randrange(len(data))
    value = random.choice([2**62, -1, 10**9, 2**31, 0]).to_bytes(8, random.choice(["little", "big"]), signed=True)
    return data[:at] + value + data[at + 8 :]


def _cut_out(data: bytes, random: Random) -> bytes:
    at = random.randrange(len(data))
    return data[:at] + data[at + random.choice([1, 8, 100, 1000]) :]


def _repeated(data: bytes, random: Random) -> bytes:
    lines = data.splitlines(keepends=True)
    i = random.randrange(len(lines))
    return b"".join([*lines[: i + 1], *lines[i : i + random.choice([1, 3])], *lines[i + 1 :]])


def _with_entities(data: bytes, random: Random) -> bytes:
    body = re.sub(rb"^<\?xml.*?\?>", b"", data)
    return _ENTITY + body.replace(b">", b">&b;", 1)


def _renamed(data: bytes, random: Random) -> bytes:
    """Replace an attribute or a name."""
    found = list(re.finditer(rb'"[^"\n]{1,40}"|[A-Za-z_]{4,20}', data))
    if not found:
        return _flipped(data, random)
    one = random.choice(found)
    other = random.choice([b'""', b'"../../x"', b"Float128", b'"UInt8"', b'"Int64"', b"\xff\xfe", b'"/dev/zero"'])
    return data[: one.start()] + other + data[one.end() :]


_ACCIDENTS = (
    _truncated,
    _flipped,
    _flipped,
    _renumbered,
    _renumbered,
    _overwritten,
    _cut_out,
    _repeated,
    _with_entities,
    _renamed,
)


def mesh_file(number: int, folder: Path) -> Path:
    """Write a mutated mesh file; return its path."""
    random = Random(number)
    suffix, write = MESHES[list(MESHES)[number % len(MESHES)]]
    path = folder / f"it.{suffix}"
    write(path, 0.0)
    path.write_bytes(mutated(path.read_bytes(), random))
    return path


def _vtkhdf(path: Path) -> None:
    """Write the file that VTK's own writer makes of one grid; that is slow, so it is made once."""
    from vtkmodules.vtkIOHDF import vtkHDFWriter

    if not _MADE:
        writer = vtkHDFWriter()
        writer.SetInputData(_grid(0.0))
        writer.SetFileName(str(path))
        writer.Write()
        _MADE.append(path.read_bytes())
    path.write_bytes(_MADE[0])


def _xdmf(path: Path) -> None:
    with meshio.xdmf.TimeSeriesWriter(path, data_format="XML") as writer:
        writer.write_points_cells(POINTS, [("tetra", CELLS)])
        for t in (0.0, 0.25, 0.5):
            writer.write_data(t, point_data={"u": POINTS * t})


_MADE: list[bytes] = []
_TEMPORAL: dict[str, Callable[[Path], None]] = {"vtkhdf": _vtkhdf, "xdmf": _xdmf}


def series_index(number: int, folder: Path) -> Path:
    """Write an index of three files, one of which, or the index itself, is mutated, or one file of three steps."""
    random = Random(number)
    kind = [*WRITERS, *_TEMPORAL][number % (len(WRITERS) + len(_TEMPORAL))]
    if kind in _TEMPORAL:
        path = folder / f"their.{kind}"
        _TEMPORAL[kind](path)
        path.write_bytes(mutated(path.read_bytes(), random))
        return path
    suffix, write = WRITERS[kind]
    names = [f"f{i}.{suffix}" for i in range(3)]
    for i, name in enumerate(names):
        write(folder / name, i / 4)
    rows = [(i / 4, name) for i, name in enumerate(names)]
    index = folder / "their.pvd"
    index.write_text(
        '<?xml version="1.0"?><VTKFile type="Collection"><Collection>'
        + "".join(f'<DataSet timestep="{t}" file="{name}"/>' for t, name in rows)
        + "</Collection></VTKFile>"
    )
    if random.random() < 0.3:
        index = folder / "their.vtu.series"
        index.write_text(json.dumps({"files": [{"name": name, "time": t} for t, name in rows]}))
    harmed = index if random.random() < 0.2 else folder / random.choice(names)
    harmed.write_bytes(mutated(harmed.read_bytes(), random))
    return index
