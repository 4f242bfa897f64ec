"""Meshes as plain arrays, from every format that meshio reads."""

import io
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from pipeline.errors import MeshError, shorten

SIMPLEX_NAMES = {2: "triangle", 3: "tetra"}  # meshio's, by dimension
# cell type, dimension, count, and the nodes (count, corners) of linear simplices, None for other types
CellBlock = tuple[str, int, int, Any]


def read_plain_mesh(path: Path) -> tuple[Any, list[CellBlock], str]:
    """Return points (n, 2 or 3), the blocks of cells, and the text that meshio printed; raises MeshError.

    meshio prints, warns, and exits if no reader accepts the file; its readers pass on their parsers' errors.
    """
    printed = io.StringIO()
    try:
        with redirect_stdout(printed), redirect_stderr(printed), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            mesh = _read_mesh(path)
            points = np.ascontiguousarray(mesh.points, dtype=np.float64)
            blocks = [_make_block(block) for block in mesh.cells if len(block.data)]
    except MemoryError:
        raise
    except (Exception, SystemExit) as error:
        reason = printed.getvalue() if isinstance(error, SystemExit) else f"{type(error).__name__}: {error}"
        missing = f"; pip install {error.name}" if isinstance(error, ModuleNotFoundError) else ""
        # the parser of a text file may quote all of it; the first words are enough
        raise MeshError(f"{path}: meshio cannot read it ({shorten(' '.join(reason.split()), 300)}){missing}") from error
    return points, blocks, " ".join(printed.getvalue().split())


def _make_block(block: Any) -> CellBlock:
    is_simplex = block.type in SIMPLEX_NAMES.values()
    cells = np.ascontiguousarray(block.data, dtype=np.int64) if is_simplex else None
    return str(block.type), int(block.dim), len(block.data), cells


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
