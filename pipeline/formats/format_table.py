"""The table of the files that series are read from, for `pipeline formats` and the documentation."""

from collections.abc import Sequence
from importlib.util import find_spec
from typing import NamedTuple

from pipeline.formats.readers import FORMATS


class FormatRow(NamedTuple):
    """One format: suffixes or names, steps in a file ("one", "many", "list"), programs, and how it was tested."""

    names: tuple[str, ...]
    format: str
    steps: str
    written_by: str
    tested_with: str
    needs: str
    installed: bool


_HEAD = ("file", "format", "steps", "written by", "tested with files of", "needs")


def list_rows() -> list[FormatRow]:
    """Return a row for each format."""
    lists = [
        FormatRow(
            (".pvd",), "list of files", "list", "most solvers", "dolfinx, deal.II, MFEM, NGSolve, FEniCS", "", True
        ),
        FormatRow((".series",), "list of files (JSON)", "list", "ParaView, OpenFOAM", "OpenFOAM", "", True),
    ]
    rows = [
        FormatRow(
            row.names, row.description, "many" if row.has_steps else "one", row.programs,
            row.tested or "none: written by hand", row.package, not row.package or find_spec(row.package) is not None,
        )
        for row in FORMATS
    ]  # fmt: skip
    return [*lists, *rows]


def encode_table(rows: Sequence[FormatRow]) -> str:
    """Return the rows as lines of text in columns; a package that is not installed is marked."""
    cells = [
        (" ".join(row.names), *row[1:5], row.needs if row.installed else f"{row.needs} (pip install {row.needs})")
        for row in rows
    ]
    widths = [max(len(line[i]) for line in (_HEAD, *cells)) for i in range(len(_HEAD))]
    lines = ("  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)) for line in (_HEAD, *cells))
    return "\n".join(line.rstrip() for line in lines)
