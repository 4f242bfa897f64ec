"""The keywords of an Abaqus input file with their data lines, from the file and those that it includes."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.errors import MeshError, shorten

_DEEPEST = 10  # files that include each other


class Keyword(NamedTuple):
    """A keyword (capitals, no spaces) at its line, its options by name (capitals), and its data lines."""

    name: str
    options: dict[str, str]
    lines: list[str]
    where: str

    def make_error(self, text: str) -> MeshError:
        """Return the error of this keyword."""
        return MeshError(f"{self.where} {text}")

    def split_numbers(self, line: str) -> list[float]:
        """Return the numbers of a data line; an empty entry is zero, one at the end is left out."""
        entries = line.upper().replace("D", "E").split(",")
        if not entries[-1].strip():
            entries.pop()
        try:
            return [float(entry) if entry.strip() else 0.0 for entry in entries]
        except ValueError:
            raise self.make_error(f"has a line that is not numbers: {shorten(line)}") from None


def read_keywords(path: Path, depth: int = 0) -> Iterator[Keyword]:
    """Yield the keywords of a file, those of included files in their place; raises MeshError."""
    try:
        lines = path.read_text(encoding="latin-1").splitlines()
    except OSError as error:
        raise MeshError(f"{path}: cannot be read ({error.strerror})") from None
    if depth > _DEEPEST:
        raise MeshError(f"{path}: files include each other more than {_DEEPEST} deep")
    current: Keyword | None = None
    i = 0
    while i < len(lines):
        line, number = lines[i], i + 1
        i += 1
        if line.startswith("**") or not line.strip():
            continue
        if not line.startswith("*"):
            if current is None:
                raise MeshError(f"{path}: line {number} comes before any keyword: it is not an Abaqus input file")
            current.lines.append(line)
            continue
        while line.rstrip().endswith(",") and i < len(lines):  # a keyword line goes on after a comma
            line += lines[i]
            i += 1
        if current is not None:
            yield from _complete(current, path, depth)
        current = _split_keyword(line, f"{path}: line {number}:")
    if current is not None:
        yield from _complete(current, path, depth)


def _split_keyword(line: str, where: str) -> Keyword:
    name, *options = line.split(",")
    pairs = (option.partition("=") for option in options if option.strip())
    values = {key.strip().upper().replace(" ", ""): value.strip().strip('"') for key, _, value in pairs}
    name = name.strip("* \t").upper().replace(" ", "")
    return Keyword(name, values, [], f"{where} *{shorten(name)}")


def _complete(keyword: Keyword, path: Path, depth: int) -> Iterator[Keyword]:
    """Yield a keyword, with the data lines of the file that INPUT names, or the keywords that *INCLUDE brings."""
    name = keyword.options.get("INPUT")
    if name is None or keyword.name not in ("INCLUDE", "NODE", "ELEMENT", "NGEN"):
        yield keyword
        return
    file = path.parent / name.replace("\\", "/")
    if not file.is_file():
        raise keyword.make_error(f"needs {shorten(name)}, which is not there")
    if keyword.name == "INCLUDE":
        if keyword.lines:  # they belong to the keyword before *INCLUDE
            raise keyword.make_error("stands among the data lines of another keyword, which is not read")
        yield from read_keywords(file, depth + 1)
        return
    data = file.read_text(encoding="latin-1").splitlines()
    yield keyword._replace(lines=keyword.lines + [line for line in data if line.strip() and not line.startswith("*")])


def read_numbers(keyword: Keyword) -> Any:
    """Return the data lines as an array (lines, numbers), short lines filled with zeros; raises MeshError."""
    if not keyword.lines:
        return np.zeros((0, 1))
    try:  # lines of equal length, which numpy reads fifty times as fast
        return np.loadtxt([line.rstrip(" ,\r") for line in keyword.lines], delimiter=",", ndmin=2, comments=None)
    except ValueError:
        rows = [keyword.split_numbers(line) for line in keyword.lines]
    out = np.zeros((len(rows), max(map(len, rows))))
    for i, row in enumerate(rows):
        out[i, : len(row)] = row
    return out


def join_rows(keyword: Keyword, length: int) -> Any:
    """Return the data lines as an array (rows, length), a long row from several lines; None if they name instances."""
    lines = [line.rstrip(" ,\r") for line in keyword.lines]
    if not lines:
        return np.zeros((0, length))
    try:
        rows = np.loadtxt(lines, delimiter=",", ndmin=2, comments=None)
        if rows.shape[1] == length:
            return rows
    except ValueError:
        if any(any(c.isalpha() for c in line) for line in lines):
            return None
    numbers: list[list[float]] = [[]]
    for line in lines:
        numbers[-1] += keyword.split_numbers(line)
        if len(numbers[-1]) == length:
            numbers.append([])
        elif len(numbers[-1]) > length:
            raise keyword.make_error(f"has a row of {len(numbers[-1])} numbers; {length} are needed")
    if numbers.pop():
        raise keyword.make_error(f"ends within a row of {length} numbers")
    return np.array(numbers)
