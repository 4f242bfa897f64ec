"""Meshes as plain arrays, from the formats that meshio reads."""

import io
import re
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from pipeline.errors import MeshError, shorten
from pipeline.formats.meshes.gmsh_groups import group_by_entity, read_entity_groups
from pipeline.formats.meshes.plain_mesh import CellGroup, PlainMesh, find_integer_fields, group_by_number, make_block

_REGIONS = ("gmsh:physical", "netgen:index", "medit:ref", "cell_tags", "su2:tag", "avsucd:material")


# parts of files of which meshio reads only the first, or the last, without a word
_PARTS = {
    **dict.fromkeys((".tec", ".dat"), (re.compile(rb"^\s*ZONE\b", re.IGNORECASE | re.MULTILINE), "zones")),
    **dict.fromkeys(
        (".post", ".dato"), (re.compile(rb"^\s*\$\s*COOR", re.IGNORECASE | re.MULTILINE), "$COOR sections")
    ),
    ".su2": (re.compile(rb"^\s*NDIME\s*=", re.MULTILINE), "zones"),
}


def read_by_meshio(path: Path) -> PlainMesh:
    """Return the mesh of a file; a note repeats the text that meshio printed; raises MeshError.

    meshio prints, warns, and exits if no reader accepts the file; its readers pass on their parsers' errors.
    """
    _check_parts(path)
    printed = io.StringIO()
    try:
        with redirect_stdout(printed), redirect_stderr(printed), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            mesh = _read_mesh(path)
            points = np.ascontiguousarray(mesh.points, dtype=np.float64)
            blocks = [make_block(str(b.type), int(b.dim), b.data) for b in mesh.cells if len(b.data)]
            top = max((dimension for _, dimension, *_ in blocks), default=0)
            groups = _find_groups(path, mesh, top)
            fields = {key: _pick_values(mesh, values, top) for key, values in mesh.cell_data.items()}
    except MemoryError:
        raise
    except (Exception, SystemExit) as error:
        reason = printed.getvalue() if isinstance(error, SystemExit) else f"{type(error).__name__}: {error}"
        missing = f"; pip install {error.name}" if isinstance(error, ModuleNotFoundError) else ""
        # the parser of a text file may quote all of it; the first words are enough
        raise MeshError(f"{path}: meshio cannot read it ({shorten(' '.join(reason.split()), 300)}){missing}") from error
    output = " ".join(printed.getvalue().split())
    notes = [f"meshio says: {output}"] if output else []
    return PlainMesh(points, blocks, notes, [name for name, *_ in groups], [], groups, find_integer_fields(fields))


def _check_parts(path: Path) -> None:
    """Raise MeshError if meshio would drop a part of the file, or take nodes for others."""
    suffix = path.suffix.lower()
    if suffix in _PARTS:
        pattern, name = _PARTS[suffix]
        count = len(pattern.findall(path.read_bytes()))
        if count > 1:
            raise MeshError(f"{path}: has {count} {name}, of which meshio reads one; write them as one mesh")
    if suffix == ".mdpa":
        nodes = re.search(rb"^\s*Begin\s+Nodes\s*\n(.*?)^\s*End\s+Nodes", path.read_bytes(), re.DOTALL | re.MULTILINE)
        ids = [line.split()[0] for line in nodes[1].splitlines() if line.strip()] if nodes else []
        wrong = next((i for i, number in enumerate(ids, 1) if number != b"%d" % i), None)
        if wrong is not None:  # meshio takes the numbers for places
            raise MeshError(
                f"{path}: node {wrong} has the number {ids[wrong - 1].decode('latin-1')}; number them 1, 2, 3…"
            )


def _find_groups(path: Path, mesh: Any, top: int) -> list[CellGroup]:
    """Return the groups of the cells of the highest dimension, by the names in the file if it has any."""
    names = {int(number): str(name) for name, (number, d) in _list_names(mesh) if int(d) == top}
    if path.suffix.lower() == ".msh" and "gmsh:geometrical" in mesh.cell_data:
        of_entities = read_entity_groups(path, top)
        if of_entities:
            return group_by_entity(_pick_values(mesh, mesh.cell_data["gmsh:geometrical"], top), of_entities, names)
    for key in _REGIONS:
        if key in mesh.cell_data:
            values = _pick_values(mesh, mesh.cell_data[key], top)
            return group_by_number(values, "region", names) if values.ndim == 1 and len(values) else []
    return _list_sets(mesh, top)


def _pick_values(mesh: Any, blocks: Any, top: int) -> Any:
    """Return the values of the cells of the highest dimension, block by block."""
    pairs = zip(mesh.cells, blocks, strict=True)
    values = [np.asarray(values) for block, values in pairs if len(block.data) and block.dim == top]
    return np.concatenate(values) if values else np.zeros(0)


def _list_sets(mesh: Any, top: int) -> list[CellGroup]:
    """Return the named sets of the cells of the highest dimension; meshio counts them in each block."""
    groups = []
    for name, places in (mesh.cell_sets or {}).items():
        start, chosen = 0, [np.zeros(0, dtype=np.int64)]
        for block, cells in zip(mesh.cells, places, strict=True):
            if block.dim == top:
                chosen += [start + np.ravel(cells).astype(np.int64)] if cells is not None and len(cells) else []
                start += len(block.data)
        members = np.concatenate(chosen)
        if len(members):
            groups.append((str(name), "", members))
    return groups


def _list_names(mesh: Any) -> list[tuple[str, Any]]:
    return [(name, value) for name, value in (mesh.field_data or {}).items() if np.size(value) == 2]


def _read_mesh(path: Path) -> Any:
    """Return meshio's mesh, even of a gmsh 4.1 file in which only some entities belong to a physical group.

    meshio 5.3 requires a group for all of them or for none; without the section $Entities it sees none.
    """
    import meshio

    try:
        return meshio.read(path)
    except ValueError as error:
        if "gmsh:physical" not in str(error):
            raise
    content = path.read_bytes().replace(b"$Entities", b"$Ignored_").replace(b"$EndEntities", b"$EndIgnored_")
    with TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        copy.write_bytes(content)
        return meshio.read(copy)
