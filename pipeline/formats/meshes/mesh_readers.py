"""Every format that meshes of cases are read from, in a child process: readers of our own, and meshio's."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pipeline.errors import MeshError
from pipeline.formats.meshes.abaqus import read_abaqus
from pipeline.formats.meshes.grid_mesh import read_grid_mesh
from pipeline.formats.meshes.meshio_reader import read_by_meshio
from pipeline.formats.meshes.nastran import read_nastran
from pipeline.formats.meshes.plain_mesh import PlainMesh
from pipeline.formats.meshes.text_meshes import read_medit, read_tetgen
from pipeline.formats.readers import READERS

MESH_READERS: Mapping[str, Callable[[Path], PlainMesh]] = {
    **dict.fromkeys(READERS, read_grid_mesh),
    ".inp": read_abaqus,
    **dict.fromkeys((".bdf", ".nas", ".fem"), read_nastran),
    **dict.fromkeys((".node", ".ele"), read_tetgen),
    ".mesh": read_medit,
}


def read_plain_mesh(path: Path) -> tuple[Any, ...]:
    """Return the fields of a PlainMesh as a tuple, which a child process can send; raises MeshError."""
    with path.open("rb") as stream:
        if stream.read(4) == b"$NOD":
            raise MeshError(f"{path}: is written in version 1 of gmsh's format; gmsh -save -format msh41 (not gmsh 1)")
    return tuple(MESH_READERS.get(path.suffix.lower(), read_by_meshio)(path))
