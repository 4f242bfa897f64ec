"""The physical groups of gmsh's entities: in files of version 4 the groups are those of the entities, not of cells."""

from pathlib import Path
from typing import Any

import numpy as np

from pipeline.formats.meshes.plain_mesh import CellGroup


def read_entity_groups(path: Path, dimension: int) -> dict[int, list[int]]:
    """Return the numbers of the physical groups of every entity of a dimension; {} if a file has no entities.

    meshio keeps the first group of an entity only.
    """
    from meshio.gmsh import _gmsh40, _gmsh41
    from meshio.gmsh.main import _read_header

    with path.open("rb") as stream:
        if not stream.readline().startswith(b"$MeshFormat"):
            return {}
        version, size, is_ascii = _read_header(stream)
        if not version.startswith("4"):
            return {}
        for line in stream:
            if line.strip() == b"$Entities":
                break
            if line.strip() in (b"$Nodes", b"$Elements"):
                return {}
        else:
            return {}
        if version == "4.0":
            tags = _gmsh40._read_entities(stream, is_ascii)
        else:
            tags = _gmsh41._read_entities(stream, is_ascii, size)[0]
    return {int(tag): [int(number) for number in groups] for tag, groups in tags[dimension].items()}


def group_by_entity(entities: Any, groups: dict[int, list[int]], names: dict[int, str]) -> list[CellGroup]:
    """Return the physical groups of cells by their entities (e,)."""
    entities, members = np.asarray(entities), dict[int, list[int]]()
    for entity in np.unique(entities).tolist():
        for number in groups.get(int(entity), []):
            members.setdefault(number, []).append(entity)
    return [
        (names.get(number, f"region {number}"), str(number), np.flatnonzero(np.isin(entities, members[number])))
        for number in sorted(members)
    ]
