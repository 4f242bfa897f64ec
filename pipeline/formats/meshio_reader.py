"""Meshes as meshio reads them, as plain arrays."""

import io
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from pipeline.errors import MeshError, shorten

SIMPLICES = {2: "triangle", 3: "tetra"}  # meshio's names
# kind, dimension, count, and the nodes (count, corners) where they are linear simplices
CellBlock = tuple[str, int, int, Any]


def plain_mesh(path: Path) -> tuple[Any, list[CellBlock], str]:
    """Return points (n, 2 or 3), the blocks of cells, and what meshio would have printed; raises MeshError.

    meshio prints, warns and, where no reader takes the file, exits; its readers raise whatever their parser does.
    """
    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            raw = _parsed(path)
            points = np.ascontiguousarray(raw.points, dtype=np.float64)
            blocks = [_block(block) for block in raw.cells if len(block.data)]
    except MemoryError:
        raise
    except (Exception, SystemExit) as error:
        why = said.getvalue() if isinstance(error, SystemExit) else f"{type(error).__name__}: {error}"
        missing = f"; pip install {error.name}" if isinstance(error, ModuleNotFoundError) else ""
        # the parser of a text file may quote all of it; the first words say what it stumbled on
        raise MeshError(f"{path}: meshio cannot read it ({shorten(' '.join(why.split()), 300)}){missing}") from error
    return points, blocks, " ".join(said.getvalue().split())


def _block(block: Any) -> CellBlock:
    simplices = block.type in SIMPLICES.values()
    cells = np.ascontiguousarray(block.data, dtype=np.int64) if simplices else None
    return str(block.type), int(block.dim), len(block.data), cells


def _parsed(path: Path) -> Any:
    """Return meshio's mesh, of a gmsh 4.1 file also where only some entities are in a physical group.

    meshio 5.3 wants a group for all of them or for none; without the section $Entities it knows of none.
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
